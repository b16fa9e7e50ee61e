"""Poses of ROS 1 and 2 as rosbags serializes them: odometry, transforms, inertial units, geographic poses."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from factories import ROS1, ROS2
from rosbags.typesys import get_types_from_msg

from inspect_pipeline.geometry.attitude import Attitude, Position
from inspect_pipeline.messages.pose import Transform, parser_for

TURN, PLACE = (0.1, 0.2, 0.3, 0.927362), (1.0, 2.0, 40.0)  # x, y, z, w; x, y, z
WXYZ = (TURN[3], *TURN[:3])
_TF = "geometry_msgs/TransformStamped[] transforms\n"
for _store in (ROS1, ROS2):
    if "tf2_msgs/msg/TFMessage" not in _store.types:
        _store.register(get_types_from_msg(_TF, "tf2_msgs/msg/TFMessage"))
    if "geographic_msgs/msg/GeoPoseStamped" not in _store.types:
        for _name, _text in {
            "GeoPoint": "float64 latitude\nfloat64 longitude\nfloat64 altitude\n",
            "GeoPose": "geographic_msgs/GeoPoint position\ngeometry_msgs/Quaternion orientation\n",
            "GeoPoseStamped": "std_msgs/Header header\ngeographic_msgs/GeoPose pose\n",
        }.items():
            _store.register(get_types_from_msg(_text, f"geographic_msgs/msg/{_name}"))


def make(store: Any, name: str, *fields: Any) -> Any:
    return store.types[name](*fields)


def header(store: Any, frame_id: str) -> Any:
    stamp = make(store, "builtin_interfaces/msg/Time", 1, 2)
    return make(store, "std_msgs/msg/Header", *((7,) if store is ROS1 else ()), stamp, frame_id)


def pose(store: Any) -> Any:
    point = make(store, "geometry_msgs/msg/Point", *PLACE)
    return make(store, "geometry_msgs/msg/Pose", point, make(store, "geometry_msgs/msg/Quaternion", *TURN))


def parse(store: Any, kind: str, message: Any, topic: str = "/topic") -> list[Any]:
    if store is ROS1:
        schema, encoding, data = kind.replace("/msg/", "/"), "ros1", store.serialize_ros1(message, kind)
    else:
        schema, encoding, data = kind, "cdr", store.serialize_cdr(message, kind)
    return list(parser_for(topic, schema, b"", encoding)(memoryview(bytes(data))))


@pytest.fixture(params=[ROS1, ROS2], ids=["ros1", "ros2"])
def store(request: pytest.FixtureRequest) -> Any:
    return request.param


@pytest.mark.parametrize("frame_id", ["map", "/map", "uav1/map", "odom"])
def test_odometry(store: Any, frame_id: str) -> None:
    zeros, vector = np.zeros(36), make(store, "geometry_msgs/msg/Vector3", 1.0, 2.0, 3.0)
    twist = make(store, "geometry_msgs/msg/Twist", vector, vector)
    message = make(
        store,
        "nav_msgs/msg/Odometry",
        header(store, frame_id),
        "base_link",
        make(store, "geometry_msgs/msg/PoseWithCovariance", pose(store), zeros),
        make(store, "geometry_msgs/msg/TwistWithCovariance", twist, zeros),
    )
    assert parse(store, "nav_msgs/msg/Odometry", message) == [
        Attitude(pytest.approx(WXYZ), is_camera=False, height_m=40.0)
    ]


@pytest.mark.parametrize(
    ("topic", "is_camera"), [("/mavros/local_position/pose", False), ("/gimbal/pose", True)]
)
def test_poses_with_a_namespace_and_without_a_world(store: Any, topic: str, is_camera: bool) -> None:
    kind = "geometry_msgs/msg/PoseStamped"
    for frame_id, n_found in (("uav1/map", 1), ("base_link", 0)):
        found = parse(store, kind, make(store, kind, header(store, frame_id), pose(store)), topic)
        assert [one.is_camera for one in found] == [is_camera] * n_found


def test_transforms(store: Any) -> None:
    transforms = [
        make(
            store,
            "geometry_msgs/msg/TransformStamped",
            header(store, parent),
            child,
            make(
                store,
                "geometry_msgs/msg/Transform",
                make(store, "geometry_msgs/msg/Vector3", *PLACE),
                make(store, "geometry_msgs/msg/Quaternion", *turn),
            ),
        )
        for parent, child, turn in (("map", "odom", TURN), ("a", "b", (0.0,) * 4), ("odom", "base", TURN))
    ]
    found = parse(store, "tf2_msgs/msg/TFMessage", make(store, "tf2_msgs/msg/TFMessage", transforms))
    assert found == [
        Transform("map", "odom", pytest.approx(WXYZ), PLACE),
        Transform("odom", "base", pytest.approx(WXYZ), PLACE),
    ]


@pytest.mark.parametrize(("covariance", "n_found"), [(0.0, 1), (-1.0, 0)])
def test_inertial_units(store: Any, covariance: float, n_found: int) -> None:
    nine, vector = np.full(9, covariance), make(store, "geometry_msgs/msg/Vector3", 1.0, 2.0, 3.0)
    turn = make(store, "geometry_msgs/msg/Quaternion", *TURN)
    fields = (header(store, "imu"), turn, nine, vector, nine, vector, nine)
    found = parse(store, "sensor_msgs/msg/Imu", make(store, "sensor_msgs/msg/Imu", *fields))
    assert [one.is_fallback for one in found] == [True] * n_found


def test_geographic_poses(store: Any) -> None:
    turn = make(store, "geometry_msgs/msg/Quaternion", *TURN)
    point = make(store, "geographic_msgs/msg/GeoPoint", 48.1, 11.5, 560.0)
    kind = "geographic_msgs/msg/GeoPoseStamped"
    message = make(
        store, kind, header(store, "base_link"), make(store, "geographic_msgs/msg/GeoPose", point, turn)
    )
    assert parse(store, kind, message) == [
        Position(48.1, 11.5, 560.0),
        Attitude(pytest.approx(WXYZ), is_camera=False),
    ]


@pytest.mark.parametrize(("status", "n_found"), [(-2, 1), (-1, 0), (0, 1), (2, 1)])
def test_a_fix_whose_status_is_unknown_is_one(store: Any, status: int, n_found: int) -> None:
    kind = "sensor_msgs/msg/NavSatFix"
    state = make(store, "sensor_msgs/msg/NavSatStatus", status, 1)
    message = make(store, kind, header(store, "gps"), state, 48.1, 11.5, 560.0, np.zeros(9), 0)
    assert parse(store, kind, message) == [Position(48.1, 11.5, 560.0)] * n_found
