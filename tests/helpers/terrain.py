"""Terrain models made for tests."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pyproj
import pytest

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


def write_dem(
    path: Path,
    place: tuple[float, float],
    height_m: Callable[[np.ndarray, np.ndarray], np.ndarray],
    crs: str = "EPSG:32631",
) -> Path:
    """A GeoTIFF of 1 km about a place (latitude, longitude) in UTM zone 31: heights by metres east, north."""
    rasterio = pytest.importorskip("rasterio")
    to_utm = pyproj.Transformer.from_crs("EPSG:4326", "EPSG:32631", always_xy=True)
    x, y = to_utm.transform(place[1], place[0])
    side, cell_m = 200, 5.0
    at = (np.arange(side) + 0.5) * cell_m - side * cell_m / 2
    heights = height_m(*np.meshgrid(at, -at)).astype(np.float32)
    transform = rasterio.transform.from_origin(x - side * cell_m / 2, y + side * cell_m / 2, cell_m, cell_m)
    shape = {"height": side, "width": side, "count": 1, "dtype": "float32", "nodata": -9999.0}
    with rasterio.open(path, "w", driver="GTiff", crs=crs, transform=transform, **shape) as file:
        file.write(heights, 1)
    return path
