"""Messages of positions and attitudes taken apart, whatever their schema and encoding.

`parser_for` finds what reads a channel: sensor_msgs/NavSatFix in ROS 1 and 2; Foxglove's LocationFix,
PoseInFrame and FrameTransform in protobuf, JSON, FlatBuffers and ROS 2; and PX4's positions and attitudes,
by field name, as px4_msgs or as JSON from a ULog.
"""

from __future__ import annotations

import json
import math
import re
from typing import TYPE_CHECKING, Any

from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame

from inspect_pipeline.geometry.attitude import Attitude, Height, Quaternion, position, unit_quaternion
from inspect_pipeline.messages import px4
from inspect_pipeline.messages.cdr import CdrReader, Ros1Reader
from inspect_pipeline.messages.flatbuffer import FlatbufferTable

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from inspect_pipeline.geometry.attitude import Position
    from inspect_pipeline.messages.cdr import SequentialReader

    Parser = Callable[[memoryview], Position | Attitude | Height | None]
    AttitudeParser = Callable[[memoryview, bool], Attitude | Height | None]

_NO_FIX = -1  # sensor_msgs/NavSatStatus
_CAMERA_WORDS = re.compile(r"camera|gimbal", re.IGNORECASE)
# Frames that stand still and whose axes are east, north, up.
_WORLDS = frozenset({"map", "odom", "world", "enu", "local", "local_enu"})
# Frames whose axes are forward, left, up. Those of optics look along z and are left out.
_BODIES = frozenset({"base_link", "base", "body", "vehicle", "drone", "uav"})
_GPS = "gps"  # a frame that says where the vehicle is, and not how it is turned
_CAMERAS = frozenset({"camera", "camera_link", "gimbal", "gimbal_link"})


def parser_for(topic: str, schema_name: str, schema_data: bytes, message_encoding: str) -> Parser | None:
    """What takes the messages of a channel apart; None when they are neither positions nor attitudes.

    It returns None for a message that says nothing, such as a receiver's without a fix, and raises one of
    `errors.MALFORMED`.
    """
    key = (schema_name, message_encoding)
    if key in _POSITIONS:
        return _POSITIONS[key]
    if key in _ATTITUDES:
        parse, is_camera = _ATTITUDES[key], bool(_CAMERA_WORDS.search(topic))
        return lambda payload: parse(payload, is_camera)
    return px4.parser_for(topic, schema_name, schema_data, message_encoding)


def _nav_sat_fix(reader: SequentialReader) -> Position | None:
    reader.header()
    status, _ = reader.int8(), reader.uint16()
    return position(*reader.float64s(3)) if status > _NO_FIX else None


def _ros2_location(payload: memoryview) -> Position | None:
    reader = CdrReader(payload)
    reader.header()
    return position(*reader.float64s(3))


def _protobuf_location(payload: memoryview) -> Position | None:
    message = LocationFix.FromString(bytes(payload))
    return position(message.latitude, message.longitude, message.altitude)


def _json_location(payload: memoryview) -> Position | None:
    fields: dict[str, Any] = json.loads(bytes(payload))
    altitude_m = float(fields.get("altitude", "nan"))
    return position(float(fields["latitude"]), float(fields["longitude"]), altitude_m)


def _flatbuffer_location(payload: memoryview) -> Position | None:
    table = FlatbufferTable(payload)
    return position(table.float64(2), table.float64(3), table.float64(4))


def _protobuf_pose(payload: memoryview, is_camera: bool) -> Attitude | None:
    message = PoseInFrame.FromString(bytes(payload))
    q, place = message.pose.orientation, message.pose.position
    return _pose(message.frame_id, Quaternion(q.w, q.x, q.y, q.z), is_camera, (place.x, place.y, place.z))


def _json_pose(payload: memoryview, is_camera: bool) -> Attitude | None:
    fields: dict[str, Any] = json.loads(bytes(payload))
    rotation = _json_quaternion(fields["pose"]["orientation"])
    return _pose(fields["frame_id"], rotation, is_camera, _json_place(fields["pose"].get("position", {})))


def _flatbuffer_pose(payload: memoryview, is_camera: bool) -> Attitude | None:
    table = FlatbufferTable(payload)
    pose = table.table(2)
    rotation = _flatbuffer_quaternion(pose and pose.table(1))
    return _pose(table.string(1), rotation, is_camera, _flatbuffer_place(pose and pose.table(0)))


def _ros2_pose(payload: memoryview, is_camera: bool) -> Attitude | None:
    reader = CdrReader(payload)
    _, frame_id = reader.header()
    place = reader.float64s(3)
    return _pose(frame_id, _ros_quaternion(reader), is_camera, place)


def _pose(frame_id: str, rotation: Quaternion, is_camera: bool, place: Sequence[float]) -> Attitude | None:
    """The attitude of whatever the topic is about, against a frame that stands still."""
    known = unit_quaternion(*rotation) if frame_id in _WORLDS else None
    return known and Attitude(known, is_camera, height_m=_height_m(place))


def _height_m(place: Sequence[float]) -> float | None:
    """How high x, y, z are; None at the origin, where those put everything that tell rotations only."""
    return float(place[2]) if any(place) and math.isfinite(place[2]) else None


def _protobuf_transform(payload: memoryview, _is_camera: bool) -> Attitude | Height | None:
    message = FrameTransform.FromString(bytes(payload))
    q = message.rotation
    t = message.translation
    rotation = Quaternion(q.w, q.x, q.y, q.z)
    return _transform(message.parent_frame_id, message.child_frame_id, rotation, (t.x, t.y, t.z))


def _json_transform(payload: memoryview, _is_camera: bool) -> Attitude | Height | None:
    fields: dict[str, Any] = json.loads(bytes(payload))
    rotation = _json_quaternion(fields["rotation"])
    place = _json_place(fields.get("translation", {}))
    return _transform(fields["parent_frame_id"], fields["child_frame_id"], rotation, place)


def _flatbuffer_transform(payload: memoryview, _is_camera: bool) -> Attitude | Height | None:
    table = FlatbufferTable(payload)
    rotation, place = _flatbuffer_quaternion(table.table(4)), _flatbuffer_place(table.table(3))
    return _transform(table.string(1), table.string(2), rotation, place)


def _ros2_transform(payload: memoryview, _is_camera: bool) -> Attitude | Height | None:
    reader = CdrReader(payload)
    reader.time_ns()
    parent, child = reader.string(), reader.string()
    place = reader.float64s(3)
    return _transform(parent, child, _ros_quaternion(reader), place)


def _transform(
    parent: str, child: str, rotation: Quaternion, place: Sequence[float]
) -> Attitude | Height | None:
    """The attitude of a known body against a frame that stands still. Chains are not followed."""
    if parent in _WORLDS and child == _GPS and math.isfinite(place[2]):
        return Height(float(place[2]))
    if parent not in _WORLDS or child not in _BODIES | _CAMERAS:
        return None
    known = unit_quaternion(*rotation)
    return known and Attitude(known, is_camera=child in _CAMERAS, height_m=_height_m(place))


def _json_quaternion(fields: dict[str, Any]) -> Quaternion:
    return Quaternion(*(float(fields.get(axis, 0)) for axis in "wxyz"))


def _json_place(fields: dict[str, Any]) -> list[float]:
    return [float(fields.get(axis, 0)) for axis in "xyz"]


def _flatbuffer_place(table: FlatbufferTable | None) -> list[float]:
    return [table.float64(i) for i in range(3)] if table else []


def _flatbuffer_quaternion(table: FlatbufferTable | None) -> Quaternion:
    """The rotation of a table, whose w is 1 where it is left out."""
    if table is None:
        raise ValueError("there is no rotation")
    return Quaternion(table.float64(3, 1.0), table.float64(0), table.float64(1), table.float64(2))


def _ros_quaternion(reader: SequentialReader) -> Quaternion:
    x, y, z, w = reader.float64s(4)
    return Quaternion(w, x, y, z)


_POSITIONS: dict[tuple[str, str], Parser] = {
    ("foxglove.LocationFix", "protobuf"): _protobuf_location,
    ("foxglove.LocationFix", "json"): _json_location,
    ("foxglove.LocationFix", "flatbuffer"): _flatbuffer_location,
    ("foxglove_msgs/msg/LocationFix", "cdr"): _ros2_location,
    ("sensor_msgs/msg/NavSatFix", "cdr"): lambda payload: _nav_sat_fix(CdrReader(payload)),
    ("sensor_msgs/NavSatFix", "ros1"): lambda payload: _nav_sat_fix(Ros1Reader(payload)),
}
_ATTITUDES: dict[tuple[str, str], AttitudeParser] = {
    ("foxglove.PoseInFrame", "protobuf"): _protobuf_pose,
    ("foxglove.PoseInFrame", "json"): _json_pose,
    ("foxglove.PoseInFrame", "flatbuffer"): _flatbuffer_pose,
    ("foxglove_msgs/msg/PoseInFrame", "cdr"): _ros2_pose,
    ("geometry_msgs/msg/PoseStamped", "cdr"): _ros2_pose,
    ("foxglove.FrameTransform", "protobuf"): _protobuf_transform,
    ("foxglove.FrameTransform", "json"): _json_transform,
    ("foxglove.FrameTransform", "flatbuffer"): _flatbuffer_transform,
    ("foxglove_msgs/msg/FrameTransform", "cdr"): _ros2_transform,
}
