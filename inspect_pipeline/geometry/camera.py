"""From pixels to places: the ray of a pixel, and where it meets the ground.

Flat earth about the camera; directions are (east, north, up). How far off the results are, by what is not
known exactly: docs/inspection.md, Places.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pyproj

from inspect_pipeline.geometry import local_frame as projection
from inspect_pipeline.geometry.attitude import YawPitchRoll

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike

    from inspect_pipeline.arrays import Floats


# Models whose coefficients OpenCV knows in this order, and how many it takes.
_UNDISTORTED, _N_COEFFICIENTS = frozenset({"plumb_bob", "rational_polynomial"}), frozenset({4, 5, 8, 12, 14})
_UPRIGHT = 1e-6
_FARTHEST_M, _MARCH_M = 1000.0, 2.0  # how far rays are followed over terrain, and by which steps
_EARTH = pyproj.Geod(ellps="WGS84")


@dataclass(frozen=True, slots=True)
class Intrinsics:
    """A pinhole camera with lens distortion, of the image as it is stored.

    Attributes:
        image_size: (height, width) in pixels.
        focal_px: (x, y).
        centre_px: (x, y), counted from the top-left corner of the top-left pixel.
        distortion_model: as in sensor_msgs/CameraInfo, such as "plumb_bob".
        distortion: coefficients of the model, such as k1, k2, p1, p2, k3; empty without distortion.
    """

    image_size: tuple[int, int]
    focal_px: tuple[float, float]
    centre_px: tuple[float, float]
    distortion_model: str
    distortion: tuple[float, ...]


def lens_of_view(image_size: tuple[int, int], view_deg: float) -> Intrinsics:
    """A lens without distortion whose view is `view_deg` from left to right of (height, width)."""
    height, width = image_size
    focal_px = float(width / 2 / np.tan(np.radians(view_deg) / 2))
    return Intrinsics(image_size, (focal_px, focal_px), (width / 2, height / 2), "", ())


def resized(lens: Intrinsics, image_size: tuple[int, int]) -> Intrinsics:
    """The lens of the same picture at another (height, width)."""
    sy, sx = (now / then for now, then in zip(image_size, lens.image_size, strict=True))
    (fx, fy), (cx, cy) = lens.focal_px, lens.centre_px
    return Intrinsics(
        image_size, (fx * sx, fy * sy), (cx * sx, cy * sy), lens.distortion_model, lens.distortion
    )


def camera_axes(turns: YawPitchRoll) -> Floats:
    """(3, 3): right, down and ahead of a camera, each as east, north, up."""
    axes: Floats = projection.camera_axes(*(np.array([turn]) for turn in turns))[0]
    return axes


def moved(lat_deg: float, lon_deg: float, east_m: float, north_m: float) -> tuple[float, float]:
    """The latitude and longitude so many metres away."""
    lats_deg, lons_deg = moved_all(lat_deg, lon_deg, np.array([east_m]), np.array([north_m]))
    return float(lats_deg[0]), float(lons_deg[0])


def moved_all(lat_deg: float, lon_deg: float, east_m: Floats, north_m: Floats) -> tuple[Floats, Floats]:
    """The latitudes (N,) and longitudes (N,) so many metres (N,) away from one place."""
    azimuth_deg, distance_m = np.degrees(np.arctan2(east_m, north_m)), np.hypot(east_m, north_m)
    here = np.full(len(east_m), lon_deg), np.full(len(east_m), lat_deg)
    there_lon_deg, there_lat_deg, _ = _EARTH.fwd(*here, azimuth_deg, distance_m)
    return np.asarray(there_lat_deg, np.float64), np.asarray(there_lon_deg, np.float64)


def pixel_rays(lens: Intrinsics, turns: YawPitchRoll, pixels: ArrayLike) -> Floats:
    """(N, 3) unit vectors, east, north, up, of (N, 2) pixels of a camera that is turned so in the world.

    Lens distortion is undone for "plumb_bob" and "rational_polynomial" with as many coefficients as they may
    have, and otherwise taken for none.
    """
    centred = (np.asarray(pixels, np.float64).reshape(-1, 2) - lens.centre_px) / lens.focal_px
    is_known = lens.distortion_model in _UNDISTORTED and len(lens.distortion) in _N_COEFFICIENTS
    if is_known and any(lens.distortion):
        flat = cv2.undistortPoints(centred[:, np.newaxis], np.eye(3), np.array(lens.distortion))
        centred = np.asarray(flat, np.float64).reshape(-1, 2)
    rays: Floats = np.column_stack((centred, np.ones(len(centred)))) @ camera_axes(turns)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    return rays


def meet_ground(rays: Floats, height_m: float) -> Floats:
    """(N, 3) metres east, north and up from the camera to where rays meet flat ground `height_m` below it.

    NaN for rays that do not go down.
    """
    down = -rays[:, 2]
    distance_m = np.full(len(rays), np.nan)
    np.divide(height_m, down, out=distance_m, where=down > 1e-9)
    met: Floats = rays * distance_m[:, np.newaxis]
    return met


def meet_terrain(ray: Floats, height_m: float, rise_m: Callable[[Floats, Floats], Floats]) -> Floats:
    """(3,) metres east, north and up from the camera to where a ray meets ground that rises and falls.

    rise_m: metres that the ground at places (N,) east and (N,) north of the camera lies above the ground
    below the camera, which is `height_m` lower. NaN where it is not known, or not met within a kilometre.
    """
    steps_m = np.arange(0.0, _FARTHEST_M + _MARCH_M, _MARCH_M)
    east, north, up = ray[:, np.newaxis] * steps_m
    above_m = up + height_m - rise_m(east, north)
    first = int(np.argmax(~(above_m > 0)))  # NaN stops it too
    if first == 0 or not np.isfinite(above_m[first]):
        return np.full(3, np.nan)
    share = above_m[first - 1] / (above_m[first - 1] - above_m[first])
    met: Floats = ray * (steps_m[first - 1] + share * _MARCH_M)
    return met


def turned_down(vehicle: YawPitchRoll) -> YawPitchRoll:
    """How a camera is turned that looks straight down out of a vehicle, the top of its image ahead."""
    right, down, ahead = camera_axes(vehicle)
    return _turns(np.stack((right, -ahead, down)))


def _turns(axes: Floats) -> YawPitchRoll:
    """The turns of which `camera_axes` makes (3, 3) axes."""
    right, down, ahead = axes
    pitch_rad = np.arcsin(np.clip(ahead[2], -1, 1))
    if np.hypot(ahead[0], ahead[1]) < _UPRIGHT:  # yaw and roll turn about one axis: all of it is yaw
        yaw_rad, roll_rad = np.arctan2(-right[1], right[0]), 0.0
    else:
        yaw_rad, roll_rad = np.arctan2(ahead[0], ahead[1]), np.arctan2(-right[2], -down[2])
    return YawPitchRoll(*(float(np.degrees(turn)) for turn in (yaw_rad, pitch_rad, roll_rad)))
