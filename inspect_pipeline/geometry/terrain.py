"""How the ground rises and falls, by a terrain model (GeoTIFF and the like, extra `geo`).

The only user of rasterio. Heights are differences from one place: what a model counts its heights from need
not be what positions count theirs from.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pyproj
from scipy.ndimage import map_coordinates

from inspect_pipeline.errors import TerrainError

if TYPE_CHECKING:
    from pathlib import Path

    from inspect_pipeline.arrays import Floats, Floats32


_MAX_CELLS = 1 << 26


@dataclass(frozen=True, slots=True, eq=False)
class Elevation:
    """A terrain model: heights (H, W) in m at the centres of cells, NaN where it has none.

    to_cells: (2, 3), of homogeneous x, y of the model's coordinates, columns and rows from the first centre.
    """

    heights_m: Floats32
    to_cells: Floats
    from_degrees: pyproj.Transformer

    def at(self, lat_deg: Floats, lon_deg: Floats) -> Floats:
        """(N,) m of (N,) places, between the nearest four cells; NaN beside the model."""
        x, y = self.from_degrees.transform(np.asarray(lon_deg, np.float64), np.asarray(lat_deg, np.float64))
        columns, rows = self.to_cells @ np.stack((x, y, np.ones_like(x)))
        heights: Floats = map_coordinates(
            self.heights_m, [rows, columns], np.float64, order=1, mode="constant", cval=np.nan
        )
        return heights


def load_elevation(path: Path) -> Elevation:
    """The first band of a terrain model; raises TerrainError when it, or rasterio, cannot be used."""
    try:
        import rasterio  # noqa: PLC0415 - an extra
    except ImportError as error:
        remedy = "pip install 'lsnet-pipe[geo]'"
        raise TerrainError(path, "rasterio, which reads it, is not installed", remedy) from error
    try:
        with rasterio.open(path) as model:
            if model.crs is None:
                raise TerrainError(path, "does not say where it lies", "give one with coordinates")
            if model.width * model.height > _MAX_CELLS:
                size = f"has {model.width} x {model.height} cells, which are too many"
                raise TerrainError(path, size, "cut out the area of the flights with gdalwarp")
            heights_m = model.read(1, masked=True).astype(np.float32).filled(np.nan)
            inverse, crs = ~model.transform, model.crs.to_wkt()
        from_degrees = pyproj.Transformer.from_crs("EPSG:4979", crs, always_xy=True)
    except (rasterio.errors.RasterioError, pyproj.exceptions.ProjError) as error:
        raise TerrainError(path, "cannot be read as a terrain model", "give a GeoTIFF") from error
    to_cells = np.array([[inverse.a, inverse.b, inverse.c - 0.5], [inverse.d, inverse.e, inverse.f - 0.5]])
    return Elevation(heights_m, to_cells, from_degrees)


def digest(path: Path) -> str:
    """The SHA-256 of a terrain model that can be used; raises TerrainError."""
    load_elevation(path)
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
