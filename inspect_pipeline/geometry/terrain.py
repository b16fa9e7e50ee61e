"""Ground below the camera: where rays meet flat ground, or a terrain model (extra `geo`).

The only user of rasterio. Only differences of a model's heights are used, so its vertical datum does not
matter.
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
    from collections.abc import Callable
    from pathlib import Path

    from inspect_pipeline.arrays import Floats, Floats32


MAX_CELLS = 1 << 26  # of a terrain model that is read
_MAX_RANGE_M, _STEP_M = 1000.0, 2.0  # how far rays are followed over terrain, and in which steps


def meet_ground(rays: Floats, height_m: float) -> Floats:
    """Intersect rays from a camera with flat ground `height_m` below it.

    Args:
        rays: (N, 3) unit vectors (east, north, up).
        height_m: of the camera above the ground.

    Returns:
        (N, 3) metres east, north and up from the camera; NaN for rays that do not go down.
    """
    down = -rays[:, 2]
    distance_m = np.full(len(rays), np.nan)
    np.divide(height_m, down, out=distance_m, where=down > 1e-9)
    met: Floats = rays * distance_m[:, np.newaxis]
    return met


def meet_terrain(ray: Floats, height_m: float, rise_m: Callable[[Floats, Floats], Floats]) -> Floats:
    """Intersect one ray (3,) from a camera with uneven ground.

    Args:
        ray: unit vector (east, north, up).
        height_m: of the camera above the ground below it.
        rise_m: takes (N,) metres east and (N,) north of the camera, returns how far the ground there lies
            above the ground below the camera, NaN where that is unknown.

    Returns:
        (3,) metres east, north and up from the camera; NaN where the ray leaves the known ground or meets
        none within a kilometre.
    """
    steps_m = np.arange(0.0, _MAX_RANGE_M + _STEP_M, _STEP_M)
    east, north, up = ray[:, np.newaxis] * steps_m
    above_m = up + height_m - rise_m(east, north)
    first = int(np.argmax(~(above_m > 0)))  # NaN stops the march too
    if first == 0 or not np.isfinite(above_m[first]):
        return np.full(3, np.nan)
    share = above_m[first - 1] / (above_m[first - 1] - above_m[first])
    met: Floats = ray * (steps_m[first - 1] + share * _STEP_M)
    return met


@dataclass(frozen=True, slots=True, eq=False)
class Elevation:
    """A terrain model.

    heights_m: (H, W) at the centres of cells, NaN where the model has none.
    to_cells: (2, 3) matrix from homogeneous x, y in the model's coordinates to column and row, counted from
        the centre of the first cell.
    from_degrees: from longitude and latitude to x, y.
    """

    heights_m: Floats32
    to_cells: Floats
    from_degrees: pyproj.Transformer

    def at(self, lat_deg: Floats, lon_deg: Floats) -> Floats:
        """Return the heights (N,) in m at (N,) places, bilinear; NaN outside the model."""
        x, y = self.from_degrees.transform(np.asarray(lon_deg, np.float64), np.asarray(lat_deg, np.float64))
        columns, rows = self.to_cells @ np.stack((x, y, np.ones_like(x)))
        heights: Floats = map_coordinates(
            self.heights_m, [rows, columns], np.float64, order=1, mode="constant", cval=np.nan
        )
        return heights


def load_elevation(path: Path) -> Elevation:
    """Read the first band of a terrain model.

    Raises:
        TerrainError: the file is no terrain model, is too large, or rasterio is not installed.
    """
    try:
        import rasterio  # noqa: PLC0415 - an extra
    except ImportError as error:
        remedy = "pip install 'lsnet-pipe[geo]'"
        raise TerrainError(path, "rasterio, which reads it, is not installed", remedy) from error
    try:
        with rasterio.open(path) as model:
            if model.crs is None:
                raise TerrainError(path, "does not say where it lies", "give one with coordinates")
            if model.width * model.height > MAX_CELLS:
                size = f"has {model.width} x {model.height} cells, which are too many"
                raise TerrainError(path, size, "cut out the area of the flights with gdalwarp")
            heights_m = model.read(1, masked=True).astype(np.float32).filled(np.nan)
            inverse, crs = ~model.transform, model.crs.to_wkt()
        from_degrees = pyproj.Transformer.from_crs("EPSG:4979", crs, always_xy=True)
    except (rasterio.errors.RasterioError, pyproj.exceptions.ProjError) as error:
        raise TerrainError(
            path, "cannot be read as a terrain model", "give a GeoTIFF or an ASCII grid"
        ) from error
    to_cells = np.array([[inverse.a, inverse.b, inverse.c - 0.5], [inverse.d, inverse.e, inverse.f - 0.5]])
    return Elevation(heights_m, to_cells, from_degrees)


def digest(path: Path) -> str:
    """Return the SHA-256 of a terrain model. Raises TerrainError when it cannot be used."""
    load_elevation(path)
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
