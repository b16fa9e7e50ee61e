"""Shapes and methods of results."""

from __future__ import annotations

import numpy as np
import pytest

from lsnet.segments import Detections, Lines, Segments

TWO = np.array([[0, 0, 10, 20], [5, 5, 6, 7]], np.float32)


def test_above_keeps_the_order_and_the_threshold_itself() -> None:
    segments = Segments(np.vstack([TWO, TWO]), np.array([0.25, 0.75, 0.5, 0.1], np.float32), (30, 40))
    kept = segments.above(0.25)
    assert kept.scores.tolist() == [0.25, 0.75, 0.5]
    np.testing.assert_array_equal(kept.endpoints[:2], TWO)
    assert len(segments.above(0.9)) == 0


def test_scaled_to_another_size_moves_x_and_y_on_their_own() -> None:
    segments = Segments(TWO, np.ones(2, np.float32), (30, 40)).scaled_to((60, 20))
    np.testing.assert_allclose(segments.endpoints, [[0, 0, 5, 40], [2.5, 10, 3, 14]])
    assert segments.image_size == (60, 20)
    assert segments.endpoints.dtype == np.float32


def test_a_threshold_renumbers_the_lines_of_segments_whatever_their_order() -> None:
    segments = Segments(np.vstack([TWO, TWO]), np.array([0.9, 0.2, 0.8, 0.7], np.float32), (30, 40))
    line = np.zeros((2, 2), np.float32)
    lines = Lines((line, line + 1, line + 2), np.array([0.6, 0.1, 0.9], np.float32), (30, 40))
    found = Detections(segments, lines, np.array([2, 0, 1, -1], np.int32)).above(0.5)
    assert found.lines.points[1][0].tolist() == [2, 2]
    assert found.line_of is not None
    assert found.line_of.tolist() == [1, -1, -1]  # its line; a line below the threshold; none before
    assert found.line_of.dtype == np.int32
    assert Detections(segments, lines).above(0.5).line_of is None
    nothing = Detections(segments, Lines.empty((30, 40)), np.full(4, -1, np.int32)).above(0.75)
    assert nothing.line_of is not None
    assert nothing.line_of.tolist() == [-1, -1]


def test_empty_detections_behave_like_others() -> None:
    nothing = Detections.empty((3, 4))
    assert (len(nothing.segments), len(nothing.lines)) == (0, 0)
    assert nothing.segments.above(0.5).scaled_to((6, 8)).image_size == (6, 8)


@pytest.mark.parametrize(
    ("endpoints", "scores"), [((2, 3), (2,)), ((4,), (1,)), ((2, 4), (3,)), ((2, 4), (2, 1))]
)
def test_segments_of_other_shapes_are_refused(endpoints: tuple[int, ...], scores: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="endpoints"):
        Segments(np.zeros(endpoints, np.float32), np.zeros(scores, np.float32), (3, 4))


def test_lines_of_other_shapes_are_refused() -> None:
    line = np.zeros((2, 2), np.float32)
    assert len(Lines((line, line), np.ones(2, np.float32), (3, 4))) == 2
    with pytest.raises(ValueError, match="scores"):
        Lines((line,), np.ones(2, np.float32), (3, 4))
    with pytest.raises(ValueError, match="K >= 2"):
        Lines((line[:1],), np.ones(1, np.float32), (3, 4))
