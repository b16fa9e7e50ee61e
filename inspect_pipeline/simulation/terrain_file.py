"""The ground of a simulated flight as a terrain model that `process --dem` reads: an ASCII grid."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pyproj

from inspect_pipeline.atomic import appearing
from inspect_pipeline.errors import OutputError
from inspect_pipeline.simulation.plan import plan_flight
from inspect_pipeline.simulation.truth import GROUND_M, to_geodetic, to_local

if TYPE_CHECKING:
    from pathlib import Path

    from inspect_pipeline.arrays import Floats
    from inspect_pipeline.simulation.options import SimulationOptions
    from inspect_pipeline.simulation.plan import FlightPlan

_CELL_DEG = 4e-5  # 4.4 m from south to north
_BEYOND_DEG = 0.005  # the line, on all sides


def write_terrain(target: Path, options: SimulationOptions) -> None:
    """Write heights in degrees of WGS 84, and a .prj file beside it that says so. Raises OutputError."""
    plan = plan_flight(replace(options, faults=()))
    south_deg, west_deg, heights_m = _grid(plan)
    rows, columns = heights_m.shape
    header = (
        f"ncols {columns}\nnrows {rows}\nxllcorner {west_deg:.9f}\nyllcorner {south_deg:.9f}\n"
        f"cellsize {_CELL_DEG}\nNODATA_value -9999\n"
    )
    try:
        with appearing(target) as part, part.open("w", encoding="ascii") as file:
            file.write(header)
            np.savetxt(file, heights_m[::-1], "%.2f")
        wkt = pyproj.CRS("EPSG:4326").to_wkt("WKT1_GDAL")
        target.with_suffix(".prj").write_text(wkt + "\n", encoding="ascii")
    except OSError as error:
        raise OutputError(target, f"cannot be written ({error.strerror})", "name another file") from error


def _grid(plan: FlightPlan) -> tuple[float, float, Floats]:
    """Return the south-western corner in degrees, and heights (rows from the south, columns) of cells."""
    places = np.array([to_geodetic(plan, structure.foot)[:2] for structure in plan.line.structures])
    south_deg, west_deg = (places.min(axis=0) - _BEYOND_DEG).tolist()
    rows, columns = np.ceil((np.ptp(places, axis=0) + 2 * _BEYOND_DEG) / _CELL_DEG).astype(int).tolist()
    lat_deg, lon_deg = np.meshgrid(
        south_deg + (np.arange(rows) + 0.5) * _CELL_DEG,
        west_deg + (np.arange(columns) + 0.5) * _CELL_DEG,
        indexing="ij",
    )
    x, _ = to_local(plan, lat_deg, lon_deg)
    return south_deg, west_deg, GROUND_M + plan.line.route.ground_m(x)
