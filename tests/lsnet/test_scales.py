"""Levels: which there are, and lines of several levels as one set without doubles."""

import numpy as np
import pytest

from lsnet.lines.overlap import find_overlaps
from lsnet.lines.polylines import Polylines
from lsnet.scales import levels_of, merge_levels
from lsnet.segments import Detections, Lines, Segments

SIZE = (1080, 1920)


def found(*lines: tuple[float, float, float, float, float]) -> Detections:
    """Return straight lines x1 y1 x2 y2 score, each with two segments of its score."""
    rows = np.array(lines, np.float32).reshape(-1, 5)
    points = tuple(row[:4].reshape(2, 2) for row in rows)
    middles = (rows[:, :2] + rows[:, 2:4]) / 2
    ends = np.stack([np.hstack([rows[:, :2], middles]), np.hstack([middles, rows[:, 2:4]])], axis=1).reshape(
        -1, 4
    )
    return Detections(
        Segments(ends, np.repeat(rows[:, 4], 2), SIZE),
        Lines(points, rows[:, 4], SIZE),
        np.repeat(np.arange(len(rows)), 2).astype(np.int32),
    )


@pytest.mark.parametrize(
    ("size", "expected"),
    [
        ((128, 128), (3.0,)),
        ((360, 540), (1.0,)),
        ((864, 1152), (1.0, 1.5)),
        ((1080, 1920), (1.0,)),
        ((2160, 3840), (1.0, 0.5)),
        ((4320, 7680), (1.0, 0.5, 0.25)),
    ],
)
def test_the_size_of_an_image_chooses_its_levels(size, expected) -> None:
    assert levels_of(size) == expected
    assert levels_of(size[::-1]) == expected


def test_of_lines_that_lie_on_each_other_the_better_stays() -> None:
    fine = found((100, 500, 1000, 500, 0.6), (100, 700, 1000, 700, 0.9))
    coarse = found((150, 503, 900, 504, 0.8), (200, 900, 300, 950, 0.7))
    merged = merge_levels([fine, coarse], (1.0, 0.5))
    np.testing.assert_allclose(merged.lines.scores, [0.9, 0.8, 0.7])
    assert merged.lines.points[1][0, 0] == 150
    # The segments of the line that was dropped remain without a line, as the first level's do.
    assert merged.line_of.tolist() == [-1, -1, 0, 0, 1, 1, 2, 2]
    np.testing.assert_allclose(merged.segments.scores, [0.6, 0.6, 0.9, 0.9, 0.8, 0.8, 0.7, 0.7])


def test_twins_of_one_level_and_lines_that_cross_stay() -> None:
    twins = found((100, 500, 1000, 500, 0.9), (100, 503, 1000, 503, 0.8))
    across = found((550, 100, 550, 900, 0.7))
    assert len(merge_levels([twins, across], (1.0, 1.5)).lines) == 3


def test_levels_without_lines_change_nothing() -> None:
    one, none = found((100, 500, 1000, 500, 0.9)), Detections.empty(SIZE)
    for levels in ([one, none], [none, one]):
        merged = merge_levels(levels, (1.0, 0.5))
        assert len(merged.lines) == 1
        assert merged.line_of.tolist() == [0, 0]
    assert len(merge_levels([none, none], (1.0, 0.5)).lines) == 0


def test_a_double_beyond_a_third_line_is_found() -> None:
    """At the reach of coarse levels, a line and a near one have more pieces nearby than its double."""
    lines = Polylines.of([np.array([[10.0, y], [400.0, y]]) for y in (50, 54, 58)])
    overlaps, is_first = find_overlaps(lines, lines, 12.0), np.array([True, False, False])
    assert all(overlaps.share_of(line, is_first) > 0.9 for line in range(3))
