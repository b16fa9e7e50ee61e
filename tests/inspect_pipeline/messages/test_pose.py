"""Poses in messages of PX4 in protobuf and of MAVLink in JSON, spellings of schemas, and setpoints."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Any

import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

from inspect_pipeline.geometry.attitude import Attitude, Position
from inspect_pipeline.messages.pose import parser_for

if TYPE_CHECKING:
    from collections.abc import Sequence

HALF = math.sqrt(0.5)
WXYZ = (HALF, 0.0, 0.0, HALF)  # a quarter turn
Field = descriptor_pb2.FieldDescriptorProto


@pytest.mark.parametrize(
    "schema", ["sensor_msgs/msg/NavSatFix", "sensor_msgs/NavSatFix", "sensor_msgs::msg::dds_::NavSatFix_"]
)
def test_spellings_of_a_schema(schema: str) -> None:
    assert parser_for("/fix", schema, b"", "cdr")
    assert parser_for("/fix", schema, b"", "ros1")
    assert not parser_for("/fix", schema, b"", "json")


@pytest.mark.parametrize(
    "topic", ["/mavros/setpoint_position/local", "/mavros/global_position/gp_origin", "/target_pose", "/home"]
)
def test_setpoints_and_origins_are_not_poses(topic: str) -> None:
    assert parser_for("/mavros/local_position/pose", "geometry_msgs/msg/PoseStamped", b"", "cdr")
    assert parser_for(topic, "geometry_msgs/msg/PoseStamped", b"", "cdr") is None


def protobuf_class(name: str, fields: list[tuple[str, Any, bool]], first_number: int) -> tuple[Any, bytes]:
    """A message class made at run time, and its FileDescriptorSet."""
    file = descriptor_pb2.FileDescriptorProto(name=f"{name}.proto", package="ulog", syntax="proto3")
    message = file.message_type.add(name=name)
    for number, (field, kind, is_array) in enumerate(fields, first_number):
        label = Field.LABEL_REPEATED if is_array else Field.LABEL_OPTIONAL
        message.field.add(name=field, number=number, type=kind, label=label)
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    made = message_factory.GetMessageClass(pool.FindMessageTypeByName(f"ulog.{name}"))
    return made, descriptor_pb2.FileDescriptorSet(file=[file]).SerializeToString()


@pytest.mark.parametrize("first_number", [1, 5])
def test_px4_in_protobuf_is_read_by_field_name(first_number: int) -> None:
    old = [
        ("lat", Field.TYPE_INT32, False),
        ("lon", Field.TYPE_INT32, False),
        ("alt", Field.TYPE_INT32, False),
    ]
    gps, schema = protobuf_class("vehicle_gps_position", old, first_number)
    parse = parser_for("gps", "ulog.vehicle_gps_position", schema, "protobuf")
    assert parse is not None
    data = gps(lat=481000000, lon=115000000, alt=520000).SerializeToString()
    assert parse(memoryview(data)) == [Position(48.1, 11.5, 520.0)]

    made, schema = protobuf_class("vehicle_attitude", [("q", Field.TYPE_FLOAT, True)], first_number)
    parse = parser_for("att", "ulog.vehicle_attitude", schema, "protobuf")
    assert parse is not None
    (found,) = parse(memoryview(made(q=WXYZ).SerializeToString()))
    assert isinstance(found, Attitude)
    assert found.rotation == pytest.approx(WXYZ)
    assert found.is_ned


@pytest.mark.parametrize("schema", [b"", b"\xff" * 20, b"\x0a\x02\x0a\x00"])
def test_a_damaged_descriptor_is_not_read(schema: bytes) -> None:
    assert parser_for("gps", "ulog.vehicle_gps_position", schema, "protobuf") is None


def test_mavlink_in_json() -> None:
    def read(kind: str, **fields: float) -> Sequence[Position | Attitude]:
        parse = parser_for(f"mavlink/1/1/{kind}", f"mavlink.{kind}", b"{}", "json")
        assert parse is not None
        payload = json.dumps({"header": {}, "message": {"type": kind, **fields}}).encode()
        return parse(memoryview(payload))

    assert read("GLOBAL_POSITION_INT", lat=481000000, lon=115000000, alt=560000) == [
        Position(48.1, 11.5, 560.0)
    ]
    (by_angles,) = read("ATTITUDE", roll=0.0, pitch=0.0, yaw=math.pi / 2)
    (by_quaternion,) = read("ATTITUDE_QUATERNION", q1=HALF, q2=0.0, q3=0.0, q4=HALF)
    assert isinstance(by_angles, Attitude)
    assert isinstance(by_quaternion, Attitude)
    assert by_angles.rotation == pytest.approx(WXYZ)
    assert by_quaternion.rotation == pytest.approx(WXYZ)
