"""Spans and frames in local metres: east, north, up, with up counted from the ground.

Flat earth with the radii of the ellipsoid at the origin: within a centimetre over a kilometre.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from inspect_pipeline.arrays import Floats, Ints, Mask


_A_M, _E2 = 6_378_137.0, 0.006_694_379_990_14  # WGS 84


@dataclass(frozen=True, slots=True)
class LocalMetres:
    """Metres to the east and north of an origin."""

    lat_deg: float
    lon_deg: float

    def to_metres(self, lat_deg: Floats | float, lon_deg: Floats | float) -> Floats:
        """(..., 2) east and north of positions."""
        north_m, east_m = self._metres_per_deg()
        east = (np.asarray(lon_deg) - self.lon_deg) * east_m
        return np.stack((east, (np.asarray(lat_deg) - self.lat_deg) * north_m), axis=-1)

    def to_degrees(self, metres: Floats) -> tuple[Floats, Floats]:
        """Latitudes and longitudes of (..., 2) east and north."""
        north_m, east_m = self._metres_per_deg()
        return self.lat_deg + metres[..., 1] / north_m, self.lon_deg + metres[..., 0] / east_m

    def _metres_per_deg(self) -> tuple[float, float]:
        """Of latitude and of longitude."""
        sine = np.sin(np.radians(self.lat_deg))
        meridian_m = _A_M * (1 - _E2) / (1 - _E2 * sine**2) ** 1.5
        normal_m = _A_M / np.sqrt(1 - _E2 * sine**2)
        return float(np.radians(meridian_m)), float(np.radians(normal_m * np.cos(np.radians(self.lat_deg))))


@dataclass(frozen=True, slots=True, eq=False)
class CameraPoses:
    """Pinhole cameras of N frames, the optical axis through the middle of the image.

    positions (N, 3) in m; axes (N, 3, 3) are right, down and ahead; focal_px (N,); sizes (N, 2) are
    (width, height). NaN where the pose is not known.
    """

    positions: Floats
    axes: Floats
    focal_px: Floats
    sizes: Floats

    def __getitem__(self, frames: Ints | Mask | slice) -> CameraPoses:
        return CameraPoses(
            self.positions[frames], self.axes[frames], self.focal_px[frames], self.sizes[frames]
        )

    def project(self, points: Floats) -> tuple[Floats, Floats]:
        """(N, P, 2) pixels and (N, P) depths in m of (P, 3) points; pixels behind a camera mean nothing."""
        away = points[np.newaxis] - self.positions[:, np.newaxis]
        seen = np.einsum("nij,npj->npi", self.axes, away)
        depths = seen[..., 2]
        scale = self.focal_px[:, np.newaxis] / np.where(np.abs(depths) < 1e-9, 1e-9, depths)
        return seen[..., :2] * scale[..., np.newaxis] + self.sizes[:, np.newaxis] / 2, depths

    def rays(self, frames: Ints, pixels: Floats) -> Floats:
        """(P, 3) directions, with depth 1, of (P, 2) pixels of the (P,) frames."""
        offsets = (pixels - self.sizes[frames] / 2) / self.focal_px[frames, np.newaxis]
        ahead = np.column_stack((offsets, np.ones(len(pixels))))
        rays: Floats = np.einsum("pij,pi->pj", self.axes[frames], ahead)
        return rays


def camera_axes(yaw_deg: Floats, pitch_deg: Floats, roll_deg: Floats) -> Floats:
    """(N, 3, 3) right, down and ahead in east, north, up.

    Yaw clockwise from north, then pitch upwards, then roll to the right.
    """
    yaw, pitch, roll = (np.radians(np.asarray(angle, np.float64)) for angle in (yaw_deg, pitch_deg, roll_deg))
    zero = np.zeros_like(yaw)
    level = np.stack((np.cos(yaw), -np.sin(yaw), zero), axis=-1)  # to the right, without roll
    ahead = np.stack((np.sin(yaw) * np.cos(pitch), np.cos(yaw) * np.cos(pitch), np.sin(pitch)), axis=-1)
    below = np.cross(ahead, level)
    cosine, sine = np.cos(roll)[:, np.newaxis], np.sin(roll)[:, np.newaxis]
    axes: Floats = np.stack((cosine * level + sine * below, cosine * below - sine * level, ahead), axis=1)
    return axes
