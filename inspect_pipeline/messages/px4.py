"""Positions and attitudes in messages of PX4: a ULog converted to JSON or protobuf, or px4_msgs in ROS 2.

Fields changed names and units over the releases, so they are read by name: lat in 1e-7 degrees became
latitude_deg, alt in mm became altitude_msl_m (PX4 1.14). Field numbers of protobuf differ between converters.
"""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, Any

from inspect_pipeline.geometry.attitude import Attitude, position, unit_quaternion
from inspect_pipeline.messages.fields import decoder_for

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from inspect_pipeline.geometry.attitude import Position, Quaternion

    Fields = Mapping[str, Any]

_LEAST_FIX = 2  # fix_type: 2 is a position, 3 has the altitude too
_YAW_LOCK, _YAW_IN_EARTH_FRAME = 16, 64  # of device_flags


def parser_for(
    topic: str, schema_name: str, schema_data: bytes, message_encoding: str
) -> Callable[[memoryview], Position | Attitude | None] | None:
    """Return what parses the messages of a channel; None when they are not PX4's that are read."""
    names = _message_names(topic, schema_name, message_encoding)
    read = next((_READERS[name] for name in names if name in _READERS), None)
    decode = decoder_for(schema_name, schema_data, message_encoding) if read else None
    if read is None or decode is None:
        return None
    return lambda payload: read(decode(payload))


def _message_names(topic: str, schema_name: str, message_encoding: str) -> list[str]:
    """Return the names that a uORB message may have: of a ULog's converter, or CamelCase of px4_msgs."""
    if message_encoding == "json":
        return [schema_name, re.sub(r"_\d+$", "", topic.rpartition("/")[2])]  # instances are numbered
    if message_encoding == "protobuf":
        return [schema_name.rpartition(".")[2]]
    if message_encoding == "cdr" and schema_name.startswith("px4_msgs"):
        return [re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", re.split(r"\W+", schema_name)[-1]).lower()]
    return []


def _receiver_position(fields: Fields) -> Position | None:
    if fields.get("fix_type", _LEAST_FIX) < _LEAST_FIX:
        return None
    if "latitude_deg" in fields:
        altitude_m = fields.get("altitude_ellipsoid_m", fields.get("altitude_msl_m", math.nan))
        return position(fields["latitude_deg"], fields["longitude_deg"], altitude_m)
    altitude_mm = fields.get("alt_ellipsoid", fields.get("alt", math.nan))
    return position(fields["lat"] / 1e7, fields["lon"] / 1e7, altitude_mm / 1e3)


def _global_position(fields: Fields) -> Position | None:
    altitude_m = fields.get("alt_ellipsoid", fields.get("alt", math.nan))
    return position(fields["lat"], fields["lon"], altitude_m)


def _vehicle_attitude(fields: Fields) -> Attitude | None:
    rotation = _quaternion(fields)
    return rotation and Attitude(rotation, is_camera=False, is_ned=True)


def _gimbal_attitude(fields: Fields) -> Attitude | None:
    rotation = _quaternion(fields)
    is_locked = int(fields.get("device_flags", 0)) & (_YAW_LOCK | _YAW_IN_EARTH_FRAME)
    return rotation and Attitude(rotation, is_camera=True, is_ned=True, is_yaw_relative=not is_locked)


def _quaternion(fields: Fields) -> Quaternion | None:
    """Read the field q: w, x, y, z. pyulog spreads it over q[0] to q[3]."""
    values = fields["q"] if "q" in fields else [fields[f"q[{i}]"] for i in range(4)]
    return unit_quaternion(*map(float, values))


_READERS: dict[str, Callable[[Fields], Position | Attitude | None]] = {
    "vehicle_gps_position": _receiver_position,
    "sensor_gps": _receiver_position,
    "vehicle_global_position": _global_position,
    "vehicle_attitude": _vehicle_attitude,
    "gimbal_device_attitude_status": _gimbal_attitude,
}
