"""Positions and attitudes in messages of PX4: a ULog converted to JSON or protobuf, or px4_msgs in ROS 2.

Fields changed names and units over the releases, so they are read by name: lat in 1e-7 degrees became
latitude_deg, alt in mm became altitude_msl_m (PX4 1.14). Field numbers of protobuf differ between converters.
"""

from __future__ import annotations

import json
import math
import re
from functools import partial
from typing import TYPE_CHECKING, Any

from google.protobuf import descriptor_pool, message_factory
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.message import DecodeError, Message

from inspect_pipeline.geometry.attitude import Attitude, position, unit_quaternion
from inspect_pipeline.messages.cdr import CdrReader

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from inspect_pipeline.geometry.attitude import Position, Quaternion

    Fields = Mapping[str, Any]
    Decoder = Callable[[memoryview], Fields]

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
    """Return what parses the messages of a channel; None when they are not PX4's that are read."""
    names = _message_names(topic, schema_name, message_encoding)
    read = next((_READERS[name] for name in names if name in _READERS), None)
    decode = _decoder(schema_name, schema_data, message_encoding) if read else None
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


def _decoder(schema_name: str, schema_data: bytes, message_encoding: str) -> Decoder | None:
    if message_encoding == "json":
        return _decode_json
    if message_encoding == "cdr":
        return partial(_decode_cdr, _read_definition(schema_data.decode(errors="replace")))
    try:
        message_class = _message_class(schema_name, schema_data)
    except (DecodeError, KeyError, TypeError, ValueError):  # not a usable FileDescriptorSet
        return None
    return partial(_decode_protobuf, message_class)


def _message_class(schema_name: str, schema_data: bytes) -> type[Message]:
    """Build the class of a message from the FileDescriptorSet of its schema."""
    pool = descriptor_pool.DescriptorPool()
    for file in FileDescriptorSet.FromString(schema_data).file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(schema_name))


def _decode_protobuf(message_class: type[Message], payload: memoryview) -> Fields:
    message = message_class.FromString(bytes(payload))
    return {name: getattr(message, name) for name in message.DESCRIPTOR.fields_by_name}


def _decode_json(payload: memoryview) -> Fields:
    fields: Fields = json.loads(bytes(payload))
    return fields


def _read_definition(text: str) -> list[tuple[str, str, int | None]]:
    """Return (name, code, array length or None) of the fields, up to the first that is not a number."""
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
