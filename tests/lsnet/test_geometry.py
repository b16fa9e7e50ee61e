"""Lengths, angles and clipping, against densely sampled points."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lsnet.geometry import angle_between, clip_to_boxes, length, orientation

COORDINATE = st.floats(-50, 150, width=32)
SEGMENT = st.tuples(COORDINATE, COORDINATE, COORDINATE, COORDINATE)


def test_length_by_hand() -> None:
    np.testing.assert_allclose(length(np.array([[0, 0, 3, 4], [1, 1, 1, 1]], float)), [5, 0])


@pytest.mark.parametrize(
    ("end", "degrees"),
    [((1, 0), 0), ((1, 1), 45), ((0, 1), 90), ((-1, 1), 135), ((-1, 0), 0), ((0, -1), 90), ((1, -1), 135)],
)
def test_orientation_by_hand(end: tuple[int, int], degrees: float) -> None:
    found = orientation(np.array([[0, 0, *end]], float))
    assert np.degrees(found[0]) == pytest.approx(degrees)


@given(SEGMENT)
def test_orientation_has_no_direction_and_stays_below_pi(segment: tuple[float, ...]) -> None:
    there = np.array([segment])
    back = there[:, [2, 3, 0, 1]]
    a, b = orientation(there), orientation(back)
    assert 0 <= a[0] < np.pi
    assert angle_between(a, b)[0] == pytest.approx(0, abs=1e-9)


def test_an_angle_just_below_zero_is_not_pi() -> None:
    assert orientation(np.array([[0, 0, 1, -1e-20]]))[0] < np.pi


@pytest.mark.parametrize(("a", "b", "between"), [(0, 90, 90), (5, 175, 10), (170, 10, 20), (45, 45, 0)])
def test_angle_between_by_hand(a: float, b: float, between: float) -> None:
    found = angle_between(np.radians([a]), np.radians([b]))
    assert np.degrees(found[0]) == pytest.approx(between)


@settings(max_examples=60)
@given(SEGMENT, st.tuples(st.integers(-20, 80), st.integers(-20, 80)), st.integers(1, 60))
def test_clip_agrees_with_dense_sampling(
    segment: tuple[float, ...], corner: tuple[int, int], side: int
) -> None:
    # Points within rounding errors of the border are decided by the function, not here.
    segment = tuple(round(value * 64) / 64 for value in segment)
    (x, y), t = corner, np.linspace(0, 1, 4001)
    xs, ys = segment[0] + t * (segment[2] - segment[0]), segment[1] + t * (segment[3] - segment[1])
    inside = t[(xs >= x) & (xs <= x + side) & (ys >= y) & (ys <= y + side)]
    t_in, t_out = clip_to_boxes(segment, (x, y, x + side, y + side))
    step = 1 / 4000 + 1e-9
    if len(inside):
        assert t_in <= inside[0] + 1e-9
        assert inside[0] - t_in <= step
        assert t_out >= inside[-1] - 1e-9
        assert t_out - inside[-1] <= step
    else:
        assert t_out - t_in <= step


def test_clip_broadcasts_and_handles_parallel_segments() -> None:
    boxes = np.array([[0, 0, 10, 10], [0, 20, 10, 30]], float)
    segments = np.array([[-5, 5, 15, 5], [5, 25, 5, 28]], float)
    t_in, t_out = clip_to_boxes(segments[:, None], boxes)
    assert t_in.shape == (2, 2)
    assert (t_out > t_in).tolist() == [[True, False], [False, True]]
    np.testing.assert_allclose((t_in[0, 0], t_out[0, 0], t_in[1, 1], t_out[1, 1]), (0.25, 0.75, 0, 1))
