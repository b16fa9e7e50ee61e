"""The ground of a simulated flight as a terrain model that `process --dem` reads: an ASCII grid."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pyproj

from inspect_pipeline.atomic import appearing
from inspect_pipeline.errors import OutputError
from inspect_pipeline.geometry.terrain import MAX_CELLS
from inspect_pipeline.simulation.plan import plan_flight
from inspect_pipeline.simulation.truth import GROUND_M, to_geodetic, to_local

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from inspect_pipeline.arrays import Floats
    from inspect_pipeline.simulation.options import SimulationOptions
    from inspect_pipeline.simulation.plan import FlightPlan

_CELL_DEG = 4e-5  # 4.4 m from south to north
_BEYOND_DEG = 0.005  # the line, on all sides


class _Grid(NamedTuple):
    """Cells of _CELL_DEG; the corner is the south-western one of all."""

    south_deg: float
    west_deg: float
    n_rows: int
    n_columns: int


def check_terrain(target: Path, options: SimulationOptions) -> None:
    """Raise OutputError for a line that is too long for a terrain model."""
    _grid(target, plan_flight(replace(options, faults=())))


def write_terrain(target: Path, options: SimulationOptions) -> None:
    """Write heights in degrees of WGS 84, and a .prj file beside it that says so. Raises OutputError."""
    plan = plan_flight(replace(options, faults=()))
    grid = _grid(target, plan)
    header = (
        f"ncols {grid.n_columns}\nnrows {grid.n_rows}\n"
        f"xllcorner {grid.west_deg:.9f}\nyllcorner {grid.south_deg:.9f}\n"
        f"cellsize {_CELL_DEG}\nNODATA_value -9999\n"
    )
    try:
        with appearing(target) as part, part.open("w", encoding="ascii") as file:
            file.write(header)
            for heights_m in _rows(grid, plan):
                np.savetxt(file, heights_m[np.newaxis], "%.2f")
        wkt = pyproj.CRS("EPSG:4326").to_wkt("WKT1_GDAL")
        target.with_suffix(".prj").write_text(wkt + "\n", encoding="ascii")
    except OSError as error:
        raise OutputError(target, f"cannot be written ({error.strerror})", "name another file") from error


def _grid(target: Path, plan: FlightPlan) -> _Grid:
    """Return the cells around a line, as many as `load_elevation` reads at most. Raises OutputError."""
    places = np.array([to_geodetic(plan, structure.foot)[:2] for structure in plan.line.structures])
    south_deg, west_deg = (places.min(axis=0) - _BEYOND_DEG).tolist()
    n_rows, n_columns = np.ceil((np.ptp(places, axis=0) + 2 * _BEYOND_DEG) / _CELL_DEG).astype(int).tolist()
    if n_rows * n_columns > MAX_CELLS:
        raise OutputError(
            target,
            f"the line is so long that its terrain has {n_columns} x {n_rows} cells, which are too many",
            "give fewer --structures, or a shorter flight",
        )
    return _Grid(south_deg, west_deg, n_rows, n_columns)


def _rows(grid: _Grid, plan: FlightPlan) -> Iterator[Floats]:
    """Yield the heights at the centres of the cells of each row, from the north."""
    lon_deg = grid.west_deg + (np.arange(grid.n_columns, dtype=np.float64) + 0.5) * _CELL_DEG
    for row in reversed(range(grid.n_rows)):
        lat_deg = np.full(grid.n_columns, grid.south_deg + (row + 0.5) * _CELL_DEG)
        x, _ = to_local(plan, lat_deg, lon_deg)
        yield GROUND_M + plan.line.route.ground_m(x)
