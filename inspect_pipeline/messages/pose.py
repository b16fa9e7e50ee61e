"""Parse messages of positions, attitudes and transforms, whatever their schema and encoding.

`parser_for` finds the parser of a channel: sensor_msgs NavSatFix and Imu, geometry_msgs PoseStamped and
PoseWithCovarianceStamped, nav_msgs Odometry, tf2_msgs TFMessage and geographic_msgs GeoPoseStamped in ROS 1
and 2; Foxglove's LocationFix, PoseInFrame and FrameTransform in protobuf, JSON, FlatBuffers and ROS 2; and
messages of PX4 and MAVLink by field name.
"""

from __future__ import annotations

import json
import math
import re
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias

from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame

from inspect_pipeline.geometry.attitude import Attitude, Quaternion, position, unit_quaternion
from inspect_pipeline.messages import mavlink, px4
from inspect_pipeline.messages.cdr import CdrReader, Ros1Reader
from inspect_pipeline.messages.flatbuffer import FlatbufferTable
from inspect_pipeline.messages.names import type_name

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from inspect_pipeline.geometry.attitude import Position
    from inspect_pipeline.messages.cdr import SequentialReader

    Found: TypeAlias = "Position | Attitude | Transform"
    Parser = Callable[[memoryview], Sequence[Found]]
    PositionParser = Callable[[memoryview], Position | None]
    AttitudeParser = Callable[[memoryview, bool], Attitude | None]
    TransformParser = Callable[[memoryview], Sequence["Transform"]]

FrameRole = Literal["vehicle", "camera", "optics", "position"]

_NO_FIX = -1  # sensor_msgs/NavSatStatus; -2, of later versions, says that the status is unknown
_OTHER_PLACES = re.compile(r"set_?point|(^|/)(target|goal|home|gp_origin)", re.IGNORECASE)
_CAMERA_WORDS = re.compile(r"camera|gimbal", re.IGNORECASE)
# Frames that stand still and whose axes are east, north, up.
_WORLDS = frozenset({"map", "odom", "world", "enu", "local", "local_enu"})
# Axes forward, left, up; those of optics are right, down, ahead; "gps" has a place and no attitude.
_ROLES: dict[str, FrameRole] = {
    **dict.fromkeys(("base_link", "base", "body", "vehicle", "drone", "uav"), "vehicle"),
    **dict.fromkeys(("camera", "camera_link", "gimbal", "gimbal_link"), "camera"),
    "gps": "position",
}
_OPTICS = re.compile(r"optical(_frame)?$")


class Transform(NamedTuple):
    """A frame in its parent; the rotation is from the frame's axes to the parent's."""

    parent: str
    child: str
    rotation: Quaternion
    translation_m: tuple[float, float, float]


def is_world(frame_id: str) -> bool:
    """Whether a frame stands still with its axes east, north, up; namespaces do not matter."""
    return _base_name(frame_id) in _WORLDS


def frame_role(frame_id: str) -> FrameRole | None:
    """Return what a frame is attached to, by its name without namespaces."""
    name = _base_name(frame_id)
    return "optics" if _OPTICS.search(name) else _ROLES.get(name)


def _base_name(frame_id: str) -> str:
    return frame_id.strip("/").rsplit("/", 1)[-1].lower()


def is_setpoint(topic: str) -> bool:
    """Whether a topic says where the vehicle should be, or counts from, instead of where it is."""
    return bool(_OTHER_PLACES.search(topic))


def parser_for(topic: str, schema_name: str, schema_data: bytes, message_encoding: str) -> Parser | None:
    """Return the parser of a channel, None when it has neither positions nor attitudes.

    The parser returns nothing for a message without content, such as a receiver's without a fix, and raises
    one of `errors.MALFORMED`.
    """
    if is_setpoint(topic):
        return None
    key = (type_name(schema_name), message_encoding)
    if key in _TRANSFORMS:
        return _TRANSFORMS[key]
    if key in _GEO_POSES:
        return _GEO_POSES[key]
    single: Callable[[memoryview], Position | Attitude | None] | None = None
    if key in _POSITIONS:
        single = _POSITIONS[key]
    elif key in _ATTITUDES:
        parse, is_camera = _ATTITUDES[key], bool(_CAMERA_WORDS.search(topic))
        single = lambda payload: parse(payload, is_camera)  # noqa: E731
    else:
        single = px4.parser_for(topic, schema_name, schema_data, message_encoding)
        single = single or mavlink.parser_for(topic, schema_name, message_encoding)
    if single is None:
        return None
    return lambda payload: [found] if (found := single(payload)) else []


def _nav_sat_fix(reader: SequentialReader) -> Position | None:
    reader.header()
    status, _ = reader.int8(), reader.uint16()
    return position(*reader.float64s(3)) if status != _NO_FIX else None


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


def _ros_pose(reader: SequentialReader, is_camera: bool) -> Attitude | None:
    _, frame_id = reader.header()
    place = reader.float64s(3)
    return _pose(frame_id, _ros_quaternion(reader), is_camera, place)


def _odometry(reader: SequentialReader, is_camera: bool) -> Attitude | None:
    _, frame_id = reader.header()
    child = reader.string()
    place = reader.float64s(3)
    is_camera |= frame_role(child) == "camera"
    return _pose(frame_id, _ros_quaternion(reader), is_camera, place)


def _imu(reader: SequentialReader, _is_camera: bool) -> Attitude | None:
    """Return the vehicle's attitude in ENU (REP 145); a covariance of -1 says that there is none."""
    reader.header()
    rotation, covariance = _ros_quaternion(reader), reader.float64()
    known = unit_quaternion(*rotation) if covariance != -1 else None
    return known and Attitude(known, is_camera=False, is_fallback=True)


def _geo_pose(reader: SequentialReader) -> list[Found]:
    reader.header()
    place, known = position(*reader.float64s(3)), unit_quaternion(*_ros_quaternion(reader))
    return [*([place] if place else []), *([Attitude(known, is_camera=False)] if known else [])]


def _tf_message(reader: SequentialReader) -> list[Transform]:
    found = []
    for _ in range(reader.uint32()):
        _, parent = reader.header()
        child, place = reader.string(), reader.float64s(3)
        found += _transform(parent, child, _ros_quaternion(reader), place)
    return found


def _pose(frame_id: str, rotation: Quaternion, is_camera: bool, place: Sequence[float]) -> Attitude | None:
    """Return the attitude of what the topic is about; None unless it is given in a world frame."""
    known = unit_quaternion(*rotation) if is_world(frame_id) else None
    return known and Attitude(known, is_camera, height_m=_height_m(place))


def _height_m(place: Sequence[float]) -> float | None:
    """Return z; None at the origin, as in sources that give rotations only."""
    return float(place[2]) if any(place) and math.isfinite(place[2]) else None


def _protobuf_transform(payload: memoryview) -> list[Transform]:
    message = FrameTransform.FromString(bytes(payload))
    q = message.rotation
    t = message.translation
    rotation = Quaternion(q.w, q.x, q.y, q.z)
    return _transform(message.parent_frame_id, message.child_frame_id, rotation, (t.x, t.y, t.z))


def _json_transform(payload: memoryview) -> list[Transform]:
    fields: dict[str, Any] = json.loads(bytes(payload))
    rotation = _json_quaternion(fields["rotation"])
    place = _json_place(fields.get("translation", {}))
    return _transform(fields["parent_frame_id"], fields["child_frame_id"], rotation, place)


def _flatbuffer_transform(payload: memoryview) -> list[Transform]:
    table = FlatbufferTable(payload)
    rotation, place = _flatbuffer_quaternion(table.table(4)), _flatbuffer_place(table.table(3))
    return _transform(table.string(1), table.string(2), rotation, place)


def _ros2_transform(payload: memoryview) -> list[Transform]:
    reader = CdrReader(payload)
    reader.time_ns()
    parent, child = reader.string(), reader.string()
    place = reader.float64s(3)
    return _transform(parent, child, _ros_quaternion(reader), place)


def _transform(parent: str, child: str, rotation: Quaternion, place: Sequence[float]) -> list[Transform]:
    """Return a transform; none when the rotation or the place is not finite."""
    known = unit_quaternion(*rotation)
    if known is None or not all(map(math.isfinite, place)):
        return []
    x, y, z = place or (0.0, 0.0, 0.0)
    return [Transform(parent, child, known, (x, y, z))]


def _json_quaternion(fields: dict[str, Any]) -> Quaternion:
    return Quaternion(*(float(fields.get(axis, 0)) for axis in "wxyz"))


def _json_place(fields: dict[str, Any]) -> list[float]:
    return [float(fields.get(axis, 0)) for axis in "xyz"]


def _flatbuffer_place(table: FlatbufferTable | None) -> list[float]:
    return [table.float64(i) for i in range(3)] if table else []


def _flatbuffer_quaternion(table: FlatbufferTable | None) -> Quaternion:
    """Read a rotation; a w that is left out is 1, the default of the schema."""
    if table is None:
        raise ValueError("there is no rotation")
    return Quaternion(table.float64(3, 1.0), table.float64(0), table.float64(1), table.float64(2))


def _ros_quaternion(reader: SequentialReader) -> Quaternion:
    x, y, z, w = reader.float64s(4)
    return Quaternion(w, x, y, z)


def _in_ros(package: str, name: str, parse: Callable[..., Any]) -> dict[tuple[str, str], Callable[..., Any]]:
    """Return the parsers of a message in ROS 2 and ROS 1, by type and encoding."""
    return {
        (f"{package}/{name}", "cdr"): lambda payload, *rest: parse(CdrReader(payload), *rest),
        (f"{package}/{name}", "ros1"): lambda payload, *rest: parse(Ros1Reader(payload), *rest),
    }


_POSITIONS: dict[tuple[str, str], PositionParser] = {
    ("foxglove/LocationFix", "protobuf"): _protobuf_location,
    ("foxglove/LocationFix", "json"): _json_location,
    ("foxglove/LocationFix", "flatbuffer"): _flatbuffer_location,
    ("foxglove/LocationFix", "cdr"): _ros2_location,
    **_in_ros("sensor_msgs", "NavSatFix", _nav_sat_fix),
}
_ATTITUDES: dict[tuple[str, str], AttitudeParser] = {
    ("foxglove/PoseInFrame", "protobuf"): _protobuf_pose,
    ("foxglove/PoseInFrame", "json"): _json_pose,
    ("foxglove/PoseInFrame", "flatbuffer"): _flatbuffer_pose,
    ("foxglove/PoseInFrame", "cdr"): lambda payload, *rest: _ros_pose(CdrReader(payload), *rest),
    **_in_ros("geometry_msgs", "PoseStamped", _ros_pose),
    **_in_ros("geometry_msgs", "PoseWithCovarianceStamped", _ros_pose),
    **_in_ros("nav_msgs", "Odometry", _odometry),
    **_in_ros("sensor_msgs", "Imu", _imu),
}
_TRANSFORMS: dict[tuple[str, str], TransformParser] = {
    ("foxglove/FrameTransform", "protobuf"): _protobuf_transform,
    ("foxglove/FrameTransform", "json"): _json_transform,
    ("foxglove/FrameTransform", "flatbuffer"): _flatbuffer_transform,
    ("foxglove/FrameTransform", "cdr"): _ros2_transform,
    **_in_ros("tf2_msgs", "TFMessage", _tf_message),
}
_GEO_POSES: dict[tuple[str, str], Parser] = _in_ros("geographic_msgs", "GeoPoseStamped", _geo_pose)
