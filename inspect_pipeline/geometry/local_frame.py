"""The one flat-earth model: metres east and north of an origin, azimuthal equidistant on WGS 84.

Distances and directions from the origin are exact at any range (they are geodesics, by pyproj). Between two
other points the projection stretches lengths by less than 0.5 mm per km within 10 km of the origin.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pyproj

if TYPE_CHECKING:
    from inspect_pipeline.arrays import Floats


_EARTH = pyproj.Geod(ellps="WGS84")


@dataclass(frozen=True, slots=True)
class LocalMetres:
    """Convert between degrees (WGS 84) and metres east and north of an origin; NaN stays NaN."""

    lat_deg: float
    lon_deg: float

    def to_metres(self, lat_deg: Floats | float, lon_deg: Floats | float) -> Floats:
        """Project latitudes and longitudes (...) to metres (..., 2): east, north."""
        lat, lon = np.broadcast_arrays(np.asarray(lat_deg, np.float64), np.asarray(lon_deg, np.float64))
        here = np.full(lat.size, self.lon_deg), np.full(lat.size, self.lat_deg)
        azimuth_deg, _, distance_m = _EARTH.inv(*here, lon.ravel(), lat.ravel())
        azimuth, distance = np.radians(azimuth_deg), np.asarray(distance_m)
        metres: Floats = np.stack((distance * np.sin(azimuth), distance * np.cos(azimuth)), axis=-1)
        return metres.reshape((*lat.shape, 2))

    def to_degrees(self, metres: Floats) -> tuple[Floats, Floats]:
        """Return the latitudes (...) and longitudes (...) of metres (..., 2) east and north."""
        east, north = np.moveaxis(np.asarray(metres, np.float64), -1, 0)
        azimuth_deg = np.degrees(np.arctan2(east, north)).ravel()
        here = np.full(east.size, self.lon_deg), np.full(east.size, self.lat_deg)
        lon_deg, lat_deg, _ = _EARTH.fwd(*here, azimuth_deg, np.hypot(east, north).ravel())
        return np.reshape(lat_deg, east.shape), np.reshape(lon_deg, east.shape)
