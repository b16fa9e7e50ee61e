"""Rotations by hand and against plain trigonometry, in the conventions of ROS and PX4."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from inspect_pipeline.geometry.attitude import (
    Quaternion,
    YawPitchRoll,
    from_quaternions,
    position,
    to_enu,
    to_rotation,
    to_turns,
    unit_quaternion,
    wrapped_deg,
)

HALF = math.sqrt(0.5)
TURNS = st.builds(YawPitchRoll, st.floats(-180, 179.9), st.floats(-89.9, 89.9), st.floats(-179, 179))


def assert_same_turns(found: YawPitchRoll, wanted: YawPitchRoll) -> None:
    """Compare angles, of which -180 and 180 degrees are the same."""
    np.testing.assert_allclose(wrapped_deg(np.subtract(found, wanted)), 0, atol=1e-6)


@pytest.mark.parametrize(
    ("wxyz", "is_ned", "turns"),
    [
        ((1, 0, 0, 0), False, (90, 0, 0)),  # ROS: no rotation looks east
        ((HALF, 0, 0, HALF), False, (0, 0, 0)),  # a quarter turn to the left: north
        ((HALF, 0, HALF, 0), False, (90, -90, 0)),  # ROS: a quarter turn about left lowers the nose
        ((HALF, HALF, 0, 0), False, (90, 0, 90)),  # about forward: right side down
        ((1, 0, 0, 0), True, (0, 0, 0)),  # PX4: no rotation looks north
        ((HALF, 0, 0, HALF), True, (90, 0, 0)),  # a quarter turn about down: east
        ((HALF, 0, HALF, 0), True, (0, 90, 0)),  # about right: nose up
        ((HALF, HALF, 0, 0), True, (0, 0, 90)),
        ((1.05, 0, 0, 0), True, (0, 0, 0)),  # a norm that is nearly 1
    ],
)
def test_quaternions_by_hand(
    wxyz: tuple[float, ...], is_ned: bool, turns: tuple[float, float, float]
) -> None:
    found = to_turns(from_quaternions(wxyz, is_ned=is_ned))
    np.testing.assert_allclose(found, turns, atol=1e-6)


@given(TURNS)
def test_rotations_agree_with_elementary_matrices(turns: YawPitchRoll) -> None:
    (sy, sp, sr), (cy, cp, cr) = np.sin(np.radians(turns)), np.cos(np.radians(turns))
    yaw = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    pitch = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    roll = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    np.testing.assert_allclose(to_rotation(turns).as_matrix(), yaw @ pitch @ roll, atol=1e-12)
    assert_same_turns(to_turns(to_rotation(turns)), turns)


@given(TURNS)
def test_what_is_written_in_enu_is_read_back(turns: YawPitchRoll) -> None:
    assert_same_turns(to_turns(from_quaternions(to_enu(turns), is_ned=False)), turns)


@pytest.mark.parametrize("pitch_deg", [-90.0, 90.0])
@given(yaw_deg=st.floats(-180, 179.9), roll_deg=st.floats(-170, 170))
def test_straight_up_or_down_all_of_the_turn_is_yaw(
    pitch_deg: float, yaw_deg: float, roll_deg: float
) -> None:
    rotation = to_rotation((yaw_deg, pitch_deg, roll_deg))
    turns = to_turns(rotation)
    assert turns[2] == 0
    np.testing.assert_allclose(to_rotation(turns).as_matrix(), rotation.as_matrix(), atol=1e-6)


def test_many_rotations_are_those_of_each() -> None:
    wxyz = np.random.default_rng(0).normal(size=(50, 4))
    wxyz /= np.linalg.norm(wxyz, axis=1, keepdims=True)
    for is_ned in (True, False):
        each = [to_turns(from_quaternions(one, is_ned=is_ned)) for one in wxyz]
        np.testing.assert_allclose(to_turns(from_quaternions(wxyz, is_ned=is_ned)), each, atol=1e-9)


def test_positions_that_are_none() -> None:
    assert position(48.1, 11.5, math.inf)[:2] == (48.1, 11.5)
    assert math.isnan(position(48.1, 11.5, math.inf).altitude_m)
    for lat, lon in ((0, 0), (0.0001, 0.0001), (91, 5), (5, 181), (math.nan, 5)):
        assert position(lat, lon, 0.0) is None
    assert position(0.0, 11.5, 0.0) is not None


def test_quaternions_and_angles() -> None:
    assert unit_quaternion(0, 0, 0, 0) is None
    assert unit_quaternion(math.nan, 0, 0, 1) is None
    assert unit_quaternion(0, 0, 0, 1) == Quaternion(0, 0, 0, 1)
    assert wrapped_deg(np.array([180.0, -190.0, 359.0])).tolist() == [-180, 170, -1]
