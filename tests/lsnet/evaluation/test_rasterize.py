"""Segments as pixels."""

from __future__ import annotations

import numpy as np
import pytest

from lsnet.evaluation.rasterize import confidence_map, otsu_mask, smoothed
from lsnet.segments import Segments


def segments(*rows: tuple[float, float, float, float, float], size: tuple[int, int] = (8, 10)) -> Segments:
    table = np.array(rows, np.float32).reshape(-1, 5)
    return Segments(table[:, :4], table[:, 4], size)


def test_lines_are_eight_connected_with_both_ends() -> None:
    drawn = confidence_map(segments((1.5, 1.5, 4.5, 4.5, 0.5), (6.9, 0.1, 6.2, 7.9, 0.75)))
    expected = np.zeros((8, 10), np.float32)
    for i in range(1, 5):
        expected[i, i] = 0.5
    expected[:, 6] = 0.75
    np.testing.assert_array_equal(drawn, expected)


def test_the_highest_score_is_on_top_whatever_the_order() -> None:
    weak, strong = (0.5, 3.5, 9.5, 3.5, 0.25), (4.5, 0.5, 4.5, 7.5, 0.9)
    for rows in ([weak, strong], [strong, weak]):
        assert confidence_map(segments(*rows))[3, 4] == np.float32(0.9)


def test_endpoints_on_the_far_border_are_on_the_last_pixels() -> None:
    drawn = confidence_map(segments((10, 0, 10, 8, 1.0)))
    assert drawn[:, 9].tolist() == [1] * 8
    assert drawn.sum() == 8


def test_no_segments_make_an_empty_map() -> None:
    drawn = confidence_map(segments())
    assert (drawn.shape, drawn.any(), otsu_mask(drawn).any()) == ((8, 10), False, False)


def test_smoothing_keeps_the_sum_and_peaks_on_the_line() -> None:
    drawn = confidence_map(segments((10.5, 0.5, 10.5, 39.5, 1.0), size=(40, 21)))
    smooth = smoothed(drawn, 1.5)
    assert smooth[20].argmax() == 10
    assert abs(smooth[20].sum() - 1) < 1e-3


def test_otsu_separates_strong_lines_from_weak_ones() -> None:
    drawn = confidence_map(segments((0, 1, 10, 1, 0.1), (0, 5, 10, 5, 0.9)))
    mask = otsu_mask(drawn)
    assert mask[5].all()
    assert not mask[1].any()


@pytest.mark.parametrize("width_px", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("ends", [(5, 30, 75, 30), (5, 10, 75, 45), (40, 5, 40, 55), (30, 5, 45, 55)])
def test_lines_have_the_requested_width(width_px: int, ends: tuple[int, ...]) -> None:
    segments = Segments(np.array([ends], np.float32) + 0.5, np.ones(1, np.float32), (60, 80))
    drawn = confidence_map(segments, width_px) > 0
    is_flat = abs(ends[2] - ends[0]) >= abs(ends[3] - ends[1])
    across = drawn.sum(axis=0) if is_flat else drawn.sum(axis=1)
    assert set(across[across > 0].tolist()) == {width_px}
