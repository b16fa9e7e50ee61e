"""The four grids: encoding against densely sampled lines, and back again."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from lsnet.grid import IGNORED, NEGATIVE, POSITIVE, GridCoder

if TYPE_CHECKING:
    from numpy.typing import NDArray

SIZE = (96, 128)  # height, width
CODER = GridCoder()
HUNDREDTH = 100  # coordinates of random lines are rounded to it
POINT = st.tuples(st.integers(-6000, 19000), st.integers(-6000, 16000)).map(
    lambda p: (p[0] / HUNDREDTH, p[1] / HUNDREDTH)
)


def sampled_chord(points: NDArray[np.floating], corner: tuple[int, int]) -> NDArray[np.floating] | None:
    """First and last of many points of a polyline that lie in the 32 px cell at `corner`."""
    t = np.linspace(0, 1, 4001)[:, None]
    dense = np.vstack([a + t * (b - a) for a, b in pairwise(points)])
    inside = dense[np.all((dense >= corner) & (dense <= np.add(corner, 32)), axis=1)]
    return np.concatenate([inside[0], inside[-1]]) if len(inside) else None


def as_lines(*lines: list[tuple[float, float]]) -> list[NDArray[np.floating]]:
    return [np.array(line, float) for line in lines]


def test_the_map_of_the_paper_is_31_by_31() -> None:
    assert CODER.map_size((512, 512)) == (31, 31)
    corners = CODER.corners((512, 512))
    assert corners[0, 0].tolist() == [0, 0]
    assert corners[0, 1].tolist() == [16, 0]  # the first cell of the horizontal grid
    assert corners[1, 0].tolist() == [0, 16]
    assert corners[30, 30].tolist() == [480, 480]


@settings(max_examples=40, deadline=None)
@given(st.lists(POINT, min_size=2, max_size=4))
def test_chord_agrees_with_dense_sampling(line: list[tuple[float, float]]) -> None:
    points = np.array(line)
    steps = np.hypot(*np.diff(points, axis=0).T)
    assume(steps.min() > 1)
    tolerance = steps.max() / 4000 + 1e-6
    targets = CODER.encode([points], SIZE)
    for row, column in np.ndindex(*targets.labels.shape):
        corner = (column * 16, row * 16)
        chord = sampled_chord(points, corner)
        length = 0.0 if chord is None else float(np.hypot(*(chord[2:] - chord[:2])))
        label = targets.labels[row, column]
        if abs(length - 8) > 2 * tolerance:
            assert (label == POSITIVE) == (length > 8)
        if length > 2 * tolerance:
            assert label != NEGATIVE
        if label == POSITIVE:
            assert chord is not None
            found = targets.endpoints[row, column] * 32 + np.tile(corner, 2)
            np.testing.assert_allclose(found, chord, atol=tolerance + 1e-4)


@settings(max_examples=40, deadline=None)
@given(POINT, POINT)
def test_decoded_segments_lie_on_the_encoded_line(a: tuple[float, float], b: tuple[float, float]) -> None:
    start, end = np.array(a), np.array(b)
    assume(np.hypot(*(end - start)) > 1)
    targets = CODER.encode([np.stack([start, end])], SIZE)
    segments = CODER.decode((targets.labels == POSITIVE).astype(float), targets.endpoints, SIZE, 0.5)
    assert len(segments) == (targets.labels == POSITIVE).sum()
    along = (end - start) / np.hypot(*(end - start))
    offset = segments.endpoints.reshape(-1, 2) - start
    assert np.abs(offset @ [-along[1], along[0]]).max(initial=0) < 1e-3
    reach = offset @ along
    assert reach.min(initial=0) > -1e-3
    assert reach.max(initial=0) < np.hypot(*(end - start)) + 1e-3
    again = CODER.encode([np.stack([start, end])], SIZE)
    np.testing.assert_array_equal(again.endpoints, targets.endpoints)


@settings(max_examples=25, deadline=None)
@given(st.lists(POINT, min_size=2, max_size=4))
def test_direction_changes_only_the_order_of_endpoints(line: list[tuple[float, float]]) -> None:
    points = np.array(line)
    there, back = CODER.encode([points], SIZE), CODER.encode([points[::-1]], SIZE)
    lengths = np.hypot(*np.moveaxis(there.endpoints[..., 2:] - there.endpoints[..., :2], -1, 0))
    is_clear = (np.abs(lengths - 0.25) > 1e-6) & (there.labels == POSITIVE)
    np.testing.assert_array_equal(back.labels[is_clear], POSITIVE)
    swapped = back.endpoints[..., [2, 3, 0, 1]]
    np.testing.assert_allclose(there.endpoints[is_clear], swapped[is_clear], atol=1e-5)


def test_the_longest_chord_wins_in_any_order() -> None:
    short, long = as_lines([(2, 2), (14, 2)], [(0, 10), (32, 20)])
    for lines in ([short, long], [long, short]):
        targets = CODER.encode(lines, (32, 32))
        assert targets.labels.tolist() == [[POSITIVE]]
        np.testing.assert_allclose(targets.endpoints[0, 0], np.array([0, 10, 32, 20]) / 32, atol=1e-6)


def test_among_parallel_lines_the_one_nearer_to_the_middle_wins() -> None:
    near, far = as_lines([(0, 14), (32, 14)], [(0, 4), (32, 4.5)])
    for lines in ([near, far], [far, near]):
        np.testing.assert_allclose(
            CODER.encode(lines, (32, 32)).endpoints[0, 0] * 32, [0, 14, 32, 14], atol=1e-4
        )


def test_strictly_the_longest_chord_wins_without_a_penalty() -> None:
    near, far = as_lines([(1, 15), (31, 15)], [(0, 4), (32, 4)])
    for coder, row in ((CODER, 15), (GridCoder(off_centre_penalty=0.0), 4)):
        targets = coder.encode([near, far], (32, 32))
        np.testing.assert_allclose(targets.endpoints[0, 0, 1::2] * 32, row, atol=1e-5)


def test_curve_is_scored_by_its_chord() -> None:
    curve = as_lines([(0, 4), (16, 28), (32, 4)])
    targets = CODER.encode(curve, (32, 32))
    np.testing.assert_allclose(targets.endpoints[0, 0], [0, 4 / 32, 1, 4 / 32], atol=1e-6)


def test_line_that_leaves_and_reenters_a_cell_is_one_chord() -> None:
    detour = as_lines([(4, 10), (4, -40), (28, -40), (28, 20)])
    targets = CODER.encode(detour, (32, 32))
    np.testing.assert_allclose(targets.endpoints[0, 0] * 32, [4, 10, 28, 20], atol=1e-4)


def test_line_on_the_border_of_two_cells_is_reported_by_both() -> None:
    targets = CODER.encode(as_lines([(32, 0), (32, 64)]), (64, 64))
    assert targets.labels.tolist() == [[POSITIVE] * 3] * 3
    np.testing.assert_allclose(targets.endpoints[0, :, 0], [1, 0.5, 0])


def test_touching_a_corner_gives_no_chord() -> None:
    targets = CODER.encode(as_lines([(0, 32), (32, 0)]), (64, 64))
    assert targets.labels[0, 0] == POSITIVE
    assert targets.labels[2, 2] == NEGATIVE
    touching = CODER.encode(as_lines([(32, -32), (-32, 32)]), (32, 32))
    assert touching.labels.tolist() == [[NEGATIVE]]


@pytest.mark.parametrize(("length", "label"), [(7.9, IGNORED), (8.1, POSITIVE)])
def test_short_chords_are_ignored(length: float, label: int) -> None:
    targets = CODER.encode(as_lines([(0, 1), (length, 1)]), (32, 32))
    assert targets.labels.tolist() == [[label]]
    assert (targets.endpoints[0, 0] != 0).any() == (label == POSITIVE)


def test_no_lines_and_no_segments() -> None:
    targets = CODER.encode([], SIZE)
    assert not targets.labels.any()
    assert not targets.endpoints.any()
    assert len(CODER.decode(np.zeros((5, 7)), np.zeros((5, 7, 4)), SIZE, 0.5)) == 0
    same_place = CODER.encode(as_lines([(5, 5), (5, 5)]), SIZE)
    assert not same_place.labels.any()


def test_decode_by_hand() -> None:
    scores, endpoints = np.zeros((5, 7)), np.zeros((5, 7, 4))
    scores[2, 3], endpoints[2, 3] = 0.5, (0.25, 0, 1, 0.5)
    scores[4, 6], endpoints[4, 6] = 0.9, (-0.2, 0.5, 1.3, 0.5)  # leaves its cell
    scores[0, 0] = 0.49
    segments = CODER.decode(scores, endpoints, SIZE, 0.5)
    np.testing.assert_allclose(segments.endpoints, [[56, 32, 80, 48], [96, 80, 128, 80]])
    np.testing.assert_allclose(segments.scores, [0.5, 0.9])
    assert (segments.endpoints.dtype, segments.scores.dtype) == (np.float32, np.float32)
    assert segments.image_size == SIZE
