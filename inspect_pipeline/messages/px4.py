"""PX4's messages of positions and attitudes, from a ULog turned into JSON or from px4_msgs in ROS 2.

Their fields changed names and units over the releases, so they are found by name: lat in 1e-7 degrees
became latitude_deg, alt in mm became altitude_msl_m (PX4 1.14).
"""

from __future__ import annotations

import json
import math
import re
from functools import partial
from typing import TYPE_CHECKING, Any

from inspect_pipeline.geometry.attitude import Attitude, position, unit_quaternion
from inspect_pipeline.messages.cdr import CdrReader

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from inspect_pipeline.geometry.attitude import Position, Quaternion

    Fields = Mapping[str, Any]

_LEAST_FIX = 2  # fix_type: 2 is a position, 3 has the altitude too
_YAW_LOCK, _YAW_IN_EARTH_FRAME = 16, 64  # of device_flags
_CODES = {
    "bool": "?",
    "int8": "b",
    "uint8": "B",
    "char": "B",
    "byte": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
_FIELD = re.compile(r"(\w+)(?:\[(\d+)\])?\s+(\w+)\s*(?:#.*)?")


def parser_for(
    topic: str, schema_name: str, schema_data: bytes, message_encoding: str
) -> Callable[[memoryview], Position | Attitude | None] | None:
    """What takes the messages of a channel apart; None when they are none of PX4's that are read."""
    if message_encoding == "json":
        names = [schema_name, re.sub(r"_\d+$", "", topic.rsplit("/", 1)[-1])]  # instances are numbered
        decode: Callable[[memoryview], Fields] = _decode_json
    elif message_encoding == "cdr" and schema_name.startswith("px4_msgs/"):
        names = [re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", schema_name.rsplit("/", 1)[-1]).lower()]
        decode = partial(_decode_cdr, _read_definition(schema_data.decode(errors="replace")))
    else:
        return None
    read = next((_READERS[name] for name in names if name in _READERS), None)
    return (lambda payload: read(decode(payload))) if read else None


def _decode_json(payload: memoryview) -> Fields:
    fields: Fields = json.loads(bytes(payload))
    return fields


def _read_definition(text: str) -> list[tuple[str, str, int | None]]:
    """(name, code, length of the array or None) of the fields, up to the first that is no plain number."""
    fields = []
    for line in text.split("\n===", 1)[0].splitlines():
        stripped = line.split("#")[0].strip()
        if not stripped or "=" in stripped:
            continue
        match = _FIELD.fullmatch(stripped)
        if match is None or match[1] not in _CODES:
            break
        fields.append((match[3], _CODES[match[1]], int(match[2]) if match[2] else None))
    return fields


def _decode_cdr(definition: list[tuple[str, str, int | None]], payload: memoryview) -> Fields:
    reader = CdrReader(payload)
    return {
        name: reader.number(code) if length is None else [reader.number(code) for _ in range(length)]
        for name, code, length in definition
    }


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
    """The field q: w, x, y, z. pyulog spreads it over q[0] to q[3]."""
    values = fields["q"] if "q" in fields else [fields[f"q[{i}]"] for i in range(4)]
    return unit_quaternion(*map(float, values))


_READERS: dict[str, Callable[[Fields], Position | Attitude | None]] = {
    "vehicle_gps_position": _receiver_position,
    "sensor_gps": _receiver_position,
    "vehicle_global_position": _global_position,
    "vehicle_attitude": _vehicle_attitude,
    "gimbal_device_attitude_status": _gimbal_attitude,
}
