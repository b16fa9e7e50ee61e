"""Trees of transforms by hand: what is composed, and at which times."""

from __future__ import annotations

import math

import numpy as np
import pytest

from inspect_pipeline.geometry.attitude import Quaternion, YawPitchRoll, from_quaternions, to_enu, to_turns
from inspect_pipeline.georeference.transforms import Chain, TransformTree
from inspect_pipeline.messages.pose import Transform, frame_role, is_world

LEVEL = Quaternion(1.0, 0.0, 0.0, 0.0)
NORTH, EAST = to_enu(YawPitchRoll(0.0, 0.0, 0.0)), to_enu(YawPitchRoll(90.0, 0.0, 0.0))
NOSE_DOWN = Quaternion(math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0)  # a quarter turn about left
OPTICS = Quaternion(0.5, -0.5, 0.5, -0.5)  # REP 103: right, down, ahead in forward, left, up


def chains(*rows: tuple[int, str, str, Quaternion, tuple[float, float, float]]) -> list[Chain]:
    tree = TransformTree()
    for time_ns, parent, child, rotation, place in rows:
        tree.add(1, time_ns, Transform(parent, child, rotation, place))
    return tree.chains()


def turns(chain: Chain) -> np.ndarray:
    return to_turns(from_quaternions(chain.rotations.values, is_ned=False))


def test_a_camera_on_a_gimbal_on_a_vehicle_is_followed_to_the_map() -> None:
    """The vehicle turns from north to east at 10 m, the gimbal looks down, 0.5 m ahead and 0.1 m below."""
    camera, vehicle = chains(
        (0, "gimbal_link", "camera_optical_frame", OPTICS, (0.0, 0.0, 0.0)),
        (0, "base_link", "gimbal_link", NOSE_DOWN, (0.5, 0.0, -0.1)),
        (0, "map", "odom", LEVEL, (0.0, 0.0, 1.0)),
        (5, "odom", "base_link", NORTH, (0.0, 0.0, 9.0)),
        (7, "odom", "base_link", EAST, (3.0, 0.0, 9.0)),
    )[::2]
    assert (camera.role, vehicle.role) == ("optics", "vehicle")
    assert camera.rotations.times_ns.tolist() == [5, 7]
    np.testing.assert_allclose(turns(vehicle), [(0, 0, 0), (90, 0, 0)], atol=1e-6)
    np.testing.assert_allclose(turns(camera), [(0, -90, 0), (90, -90, 0)], atol=1e-6)
    np.testing.assert_allclose(camera.places.values, [(0, 0.5, 9.9), (3.5, 0, 9.9)], atol=1e-9)


def test_transforms_that_move_at_different_times_are_joined_by_the_last_known() -> None:
    (chain,) = chains(
        (0, "map", "odom", LEVEL, (0.0, 0.0, 1.0)),
        (4, "map", "odom", LEVEL, (0.0, 0.0, 2.0)),
        (2, "odom", "base_link", LEVEL, (0.0, 0.0, 10.0)),
        (6, "odom", "base_link", LEVEL, (0.0, 0.0, 20.0)),
    )
    assert chain.places.times_ns.tolist() == [2, 4, 6]
    assert chain.places.values[:, 2].tolist() == [11, 12, 22]


@pytest.mark.parametrize(
    "pairs",
    [
        [("base_link", "camera_link")],  # no world
        [("map", "lidar")],  # no role
        [("map", "a"), ("a", "b"), ("b", "a"), ("a", "base_link")],
        [("base_link", "base_link")],
    ],
)
def test_trees_without_a_chain(pairs: list[tuple[str, str]]) -> None:
    rows = [(t, *pair, LEVEL, (0.0, 0.0, 1.0)) for pair in pairs for t in range(3)]
    assert [chain for chain in chains(*rows) if len(pairs) == 1] == []


def test_names_of_frames() -> None:
    assert all(map(is_world, ("map", "/map", "uav1/map", "UAV1/Odom", "world")))
    assert not any(map(is_world, ("base_link", "mapping", "map/base_link", "")))
    assert [
        frame_role(name) for name in ("uav1/base_link", "/gimbal_link", "cam0_optical", "gps", "lidar")
    ] == [
        "vehicle",
        "camera",
        "optics",
        "position",
        None,
    ]
