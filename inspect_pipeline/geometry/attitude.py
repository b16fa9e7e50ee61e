"""Positions and attitudes, and the conventions in which sources give rotations.

Yaw is clockwise from north, pitch is positive upwards, roll is positive to the right, in degrees. Applied in
this order they turn the axes north, east, down (NED) into forward, right, down, as in PX4 and MAVLink. ROS
(REP 103) turns east, north, up (ENU) into forward, left, up.
"""

from __future__ import annotations

import math
import warnings
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from inspect_pipeline.arrays import Floats

_UPRIGHT_DEG = 89.9999  # pitches beyond are taken for straight up or down
_NULL_ISLAND_DEG = 0.01  # about a kilometre of open sea around 0, 0
# Both are half turns, so each is its own inverse.
_NED_ENU = Rotation.from_matrix([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
_FRD_FLU = Rotation.from_matrix(np.diag([1.0, -1.0, -1.0]))


class Position(NamedTuple):
    """A position in WGS 84; the altitude counts from the datum of its source, NaN where unknown."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float


class Quaternion(NamedTuple):
    """A rotation as the unit quaternion w + xi + yj + zk."""

    w: float
    x: float
    y: float
    z: float


class YawPitchRoll(NamedTuple):
    """A rotation as three turns, in degrees."""

    yaw_deg: float
    pitch_deg: float
    roll_deg: float


class Attitude(NamedTuple):
    """The attitude of a camera, or else of the vehicle.

    rotation: from forward, left, up to east, north, up; from forward, right, down to north, east, down where
        `is_ned`.
    is_yaw_relative: the yaw counts from the vehicle's, not from north.
    height_m: above the origin of the world frame, None where unknown.
    is_fallback: by a source whose heading may drift, used where there is no other.
    """

    rotation: Quaternion
    is_camera: bool
    is_ned: bool = False
    is_yaw_relative: bool = False
    height_m: float | None = None
    is_fallback: bool = False


def position(latitude_deg: float, longitude_deg: float, altitude_m: float) -> Position | None:
    """Return a position; None for one out of range, or near 0, 0, which receivers without a fix report."""
    is_on_earth = abs(latitude_deg) <= 90 and abs(longitude_deg) <= 180
    if not is_on_earth or max(abs(latitude_deg), abs(longitude_deg)) < _NULL_ISLAND_DEG:
        return None
    known_m = float(altitude_m) if math.isfinite(altitude_m) else math.nan
    return Position(float(latitude_deg), float(longitude_deg), known_m)


def unit_quaternion(w: float, x: float, y: float, z: float) -> Quaternion | None:
    """Return a quaternion; None when its norm is not near 1, as where a source fills in zeros."""
    return Quaternion(w, x, y, z) if 0.9 < math.hypot(w, x, y, z) < 1.1 else None


def to_rotation(turns_deg: ArrayLike) -> Rotation:
    """Return the rotations from forward, right, down to north, east, down of (..., 3) turns."""
    return Rotation.from_euler("ZYX", np.asarray(turns_deg, np.float64), degrees=True)


def to_turns(rotation: Rotation) -> Floats:
    """Return the (..., 3) yaw, pitch and roll in degrees that `to_rotation` takes.

    Straight up or down, yaw and roll turn about one axis: all of the turn is returned as yaw.
    """
    with warnings.catch_warnings(action="ignore"):  # SciPy warns of exactly this case
        turns: Floats = rotation.as_euler("ZYX", degrees=True)
    yaw, pitch, roll = np.moveaxis(turns, -1, 0)
    is_upright = np.abs(pitch) > _UPRIGHT_DEG
    yaw = np.where(is_upright, yaw - np.sign(pitch) * roll, yaw)
    return np.stack((wrapped_deg(yaw), pitch, np.where(is_upright, 0.0, roll)), axis=-1)


def from_quaternions(wxyz: ArrayLike, *, is_ned: bool) -> Rotation:
    """Return the rotations of (..., 4) quaternions w, x, y, z that are given in NED, else in ENU."""
    rotation = Rotation.from_quat(np.asarray(wxyz, np.float64)[..., [1, 2, 3, 0]])
    return rotation if is_ned else _NED_ENU * rotation * _FRD_FLU


def to_enu(turns: YawPitchRoll) -> Quaternion:
    """Return the rotation from forward, left, up to east, north, up, as ROS and Foxglove have it."""
    x, y, z, w = (_NED_ENU * to_rotation(turns) * _FRD_FLU).as_quat().tolist()
    return Quaternion(w, x, y, z)


def wrapped_deg(angle_deg: ArrayLike) -> Floats:
    """Return the same angles within -180 <= angle < 180."""
    return (np.asarray(angle_deg, np.float64) + 180) % 360 - 180
