"""Stretches that continue each other's direction are joined, each end with one other."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lsnet.lines.bridging import group_stretches
from lsnet.lines.polylines import Polylines


def straight(start: tuple[float, float], end: tuple[float, float], count: int = 12) -> np.ndarray:
    return np.linspace(start, end, count)


def groups(polylines: list[np.ndarray], max_gap_px: float = 60.0) -> list[list[int]]:
    labels = group_stretches(Polylines.of(polylines), max_gap_px)
    return sorted(np.flatnonzero(labels == label).tolist() for label in set(labels.tolist()))


def test_no_polylines_and_one_polyline() -> None:
    assert groups([]) == []
    assert groups([straight((0, 0), (100, 0))]) == [[0]]


@pytest.mark.parametrize(
    ("other", "is_joined"),
    [
        (straight((150, 0), (300, 0)), True),
        (straight((300, 0), (150, 0)), True),  # whichever way round
        (straight((170, 0), (300, 0)), False),  # too far
        (straight((80, 0), (300, 0)), True),  # they overlap a little
        (straight((30, 0), (300, 0)), False),  # they lie beside each other
        (straight((150, 5), (300, 5)), False),  # another line, parallel
        (straight((150, 0), (300, 15)), False),  # it turns away by six degrees
        (straight((150, 0), (300, 5)), True),
    ],
)
def test_polylines_that_continue_each_other_are_joined(other: np.ndarray, is_joined: bool) -> None:
    one = straight((0, 0), (100, 0))
    assert groups([one, other]) == ([[0, 1]] if is_joined else [[0], [1]])


def test_halves_of_crossing_lines_find_each_other() -> None:
    """The arms of a cross of 30 degrees, which end 20 px before its middle."""
    arms = []
    for degrees in (0, 30, 180, 210):
        direction = np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])
        arms.append(200 + np.linspace(20, 180, 12)[:, None] * direction)
    assert groups(arms) == [[0, 2], [1, 3]]


def test_nearer_of_two_matches_is_joined() -> None:
    one = straight((0, 0), (100, 0))
    assert groups([one, straight((130, 1.2), (250, 1.2)), straight((130, 0), (250, 0))]) == [[0, 2], [1]]


def test_many_stretches_of_one_line_are_one() -> None:
    stretches = [straight((x, 0.1 * x), (x + 60, 0.1 * x + 6)) for x in (400, 0, 200, 100, 300)]
    assert groups(stretches) == [[0, 1, 2, 3, 4]]


@given(st.floats(0, np.pi), st.floats(-300, 300), st.permutations(range(4)))
def test_groups_are_invariant_to_rotation_translation_and_order(
    angle: float, shift: float, order: list[int]
) -> None:
    stretches = [
        straight((0, 0), (100, 0)),
        straight((140, 0.5), (260, 1)),
        straight((0, 40), (90, 40)),
        straight((500, 0), (600, 9)),
    ]
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    moved = [stretches[k] @ turn + shift for k in order]
    named = sorted(sorted(order[k] for k in group) for group in groups(moved))
    assert named == [[0, 1], [2], [3]]
