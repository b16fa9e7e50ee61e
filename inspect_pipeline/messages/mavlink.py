"""Positions and attitudes in MAVLink messages as JSON, as recorders on companion computers write them.

{"header": {...}, "message": {"type": "GLOBAL_POSITION_INT", "lat": 481000000, "lon": 115000000, ...}}
"""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Any

from inspect_pipeline.geometry.attitude import Attitude, Position, position, to_rotation, unit_quaternion

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    Fields = Mapping[str, Any]


def parser_for(
    topic: str, schema_name: str, message_encoding: str
) -> Callable[[memoryview], Position | Attitude | None] | None:
    """Return what parses the messages of a channel; None when they are not MAVLink's that are read."""
    if message_encoding != "json":
        return None
    names = (schema_name.rpartition(".")[2], topic.rpartition("/")[2])
    read = next((_READERS[name] for name in names if name in _READERS), None)
    return (lambda payload: read(_decode(payload))) if read else None


def _decode(payload: memoryview) -> Fields:
    fields: Fields = json.loads(bytes(payload))
    message: Fields = fields.get("message", fields)
    return message


def _global_position(fields: Fields) -> Position | None:
    """Convert degrees in 1e-7, and the altitude above the sea in millimetres."""
    return position(fields["lat"] / 1e7, fields["lon"] / 1e7, fields.get("alt", math.nan) / 1e3)


def _attitude(fields: Fields) -> Attitude | None:
    """Convert angles in radians."""
    turns_deg = [math.degrees(float(fields[name])) for name in ("yaw", "pitch", "roll")]
    x, y, z, w = to_rotation(turns_deg).as_quat().tolist()
    rotation = unit_quaternion(w, x, y, z)
    return rotation and Attitude(rotation, is_camera=False, is_ned=True)


def _attitude_quaternion(fields: Fields) -> Attitude | None:
    rotation = unit_quaternion(*(float(fields[name]) for name in ("q1", "q2", "q3", "q4")))
    return rotation and Attitude(rotation, is_camera=False, is_ned=True)


_READERS: dict[str, Callable[[Fields], Position | Attitude | None]] = {
    "GLOBAL_POSITION_INT": _global_position,
    "ATTITUDE": _attitude,
    "ATTITUDE_QUATERNION": _attitude_quaternion,
}
