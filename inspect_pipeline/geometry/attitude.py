"""Positions, and rotations as yaw, pitch and roll.

Yaw is clockwise from north, pitch is positive upwards, roll is positive to the right, all in degrees: turned
in this order, they take the axes north, east, down to forward, right, down.
"""

from __future__ import annotations

import math
from typing import NamedTuple

_UPRIGHT_SINE = 0.9999999  # of a pitch within 0.03 degrees of straight up or down


class Position(NamedTuple):
    """Where the vehicle is: WGS 84, the altitude in metres above whatever the source counts from, or NaN."""

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
    """How the camera, or else the vehicle, is turned; a relative yaw counts from that of the vehicle.

    height_m is how high it is above the origin of the frame it is turned in, None where that is not said.
    """

    turns: YawPitchRoll
    is_camera: bool
    is_yaw_relative: bool = False
    height_m: float | None = None


def position(latitude_deg: float, longitude_deg: float, altitude_m: float) -> Position | None:
    """A position; None for one that is nowhere, or at 0, 0, as receivers say that have no fix."""
    is_somewhere = abs(latitude_deg) <= 90 and abs(longitude_deg) <= 180 and (latitude_deg or longitude_deg)
    known_m = float(altitude_m) if math.isfinite(altitude_m) else math.nan
    return Position(float(latitude_deg), float(longitude_deg), known_m) if is_somewhere else None


def from_ned(rotation: Quaternion) -> YawPitchRoll | None:
    """The turns of a rotation from forward, right, down to north, east, down; None when it is none.

    As PX4 and MAVLink have it.
    """
    norm = math.hypot(*rotation)
    if not 0.9 < norm < 1.1:
        return None
    w, x, y, z = (part / norm for part in rotation)
    sine = 2 * (w * y - z * x)
    if abs(sine) > _UPRIGHT_SINE:  # yaw and roll turn about one axis: all of it is yaw
        yaw, pitch, roll = 2 * math.atan2(z, w), math.copysign(math.pi / 2, sine), 0.0
    else:
        yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        pitch = math.asin(sine)
        roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    return YawPitchRoll(wrapped_deg(math.degrees(yaw)), math.degrees(pitch), math.degrees(roll))


def from_enu(rotation: Quaternion) -> YawPitchRoll | None:
    """The turns of a rotation from forward, left, up to east, north, up; None when it is none.

    As ROS has it (REP 103).
    """
    turns = from_ned(rotation)
    if turns is None:
        return None
    return YawPitchRoll(wrapped_deg(90 - turns.yaw_deg), -turns.pitch_deg, turns.roll_deg)


def to_enu(turns: YawPitchRoll) -> Quaternion:
    """The rotation that `from_enu` takes apart."""
    (sin_y, cos_y), (sin_p, cos_p), (sin_r, cos_r) = (
        (math.sin(math.radians(turn) / 2), math.cos(math.radians(turn) / 2))
        for turn in (90 - turns.yaw_deg, -turns.pitch_deg, turns.roll_deg)
    )
    return Quaternion(
        w=cos_r * cos_p * cos_y + sin_r * sin_p * sin_y,
        x=sin_r * cos_p * cos_y - cos_r * sin_p * sin_y,
        y=cos_r * sin_p * cos_y + sin_r * cos_p * sin_y,
        z=cos_r * cos_p * sin_y - sin_r * sin_p * cos_y,
    )


def wrapped_deg(angle_deg: float) -> float:
    """The same angle within -180 <= angle < 180."""
    return (angle_deg + 180) % 360 - 180
