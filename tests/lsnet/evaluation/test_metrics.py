"""Scores by hand."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from lsnet.evaluation.metrics import (
    THRESHOLDS,
    PixelTruth,
    pixel_counts,
    pixel_scores,
    rates,
    structural_ap,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

HALF = np.array([0.5])


def horizontal(row: int, score: float = 1.0) -> NDArray[np.float32]:
    drawn = np.zeros((40, 50), np.float32)
    drawn[row] = score
    return drawn


def truth(half_width: int = 1) -> PixelTruth:
    """A cable along row 20, `half_width` rows to either side."""
    mask, centreline = np.zeros((40, 50), bool), np.zeros((40, 50), bool)
    mask[20 - half_width : 21 + half_width], centreline[20] = True, True
    return PixelTruth(mask, centreline, np.full((40, 50), half_width, np.float32))


def counts(confidence: NDArray[np.float32], tolerance_px: float = 1.0, half_width: int = 1) -> list[int]:
    return pixel_counts(confidence, truth(half_width), tolerance_px, HALF)[0].tolist()


def test_perfect_and_empty_detections() -> None:
    assert counts(horizontal(20)) == [50, 50, 50, 50]
    assert counts(np.zeros((40, 50), np.float32)) == [0, 0, 0, 50]


@pytest.mark.parametrize(("row", "right", "found"), [(22, 50, 50), (23, 0, 0), (18, 50, 50), (17, 0, 0)])
def test_tolerance_is_measured_from_the_edge_of_the_cable(row: int, right: int, found: int) -> None:
    assert counts(horizontal(row)) == [right, 50, found, 50]


def test_half_of_a_line_is_half_of_the_recall() -> None:
    confidence = horizontal(20)
    confidence[:, 25:] = 0
    assert counts(confidence, tolerance_px=0, half_width=0) == [25, 25, 25, 50]


def test_precision_counts_false_pixels() -> None:
    confidence = horizontal(20) + horizontal(5)
    (score,) = pixel_scores(np.array([[counts(confidence)]]), HALF)
    assert (score.precision, score.recall) == (0.5, 1.0)
    assert score.f1 == pytest.approx(2 / 3)


def test_thresholds_include_their_own_score() -> None:
    confidence = horizontal(20, 0.5)
    found = pixel_counts(confidence, truth(), 1.0, np.array([0.4, 0.5, 0.6]))
    assert found[:, 1].tolist() == [50, 50, 0]


def test_pixels_without_score_are_not_drawn_at_a_threshold_of_zero() -> None:
    found = pixel_counts(horizontal(20, 0.1), truth(), 1.0, np.array([0.0]))
    assert found.tolist() == [[50, 50, 50, 50]]


def test_an_image_without_cables_has_only_false_pixels() -> None:
    nothing = np.zeros((40, 50), bool)
    found = pixel_counts(horizontal(3), PixelTruth(nothing, nothing, nothing.astype(np.float32)), 1.0, HALF)
    assert found.tolist() == [[0, 50, 0, 0]]


def test_counts_are_pooled_before_dividing_and_f1_is_also_averaged() -> None:
    # Image one: 10 of 10 drawn right, 10 of 20 found. Image two: 0 of 30 right, 0 of 20 found.
    table = np.array([[[10, 10, 10, 20]], [[0, 30, 0, 20]]])
    (score,) = pixel_scores(table, np.array([0.25]))
    assert (score.threshold, score.precision, score.recall) == (0.25, 10 / 40, 10 / 40)
    assert score.f1 == pytest.approx(0.25)
    assert score.mean_f1 == pytest.approx((2 / 3 + 0) / 2)


def test_thresholds_are_0_05_apart_from_0_05() -> None:
    np.testing.assert_allclose(THRESHOLDS, [i / 20 for i in range(1, 20)])


TRUE = np.array([[0, 0, 100, 0], [0, 50, 100, 50]], float)
SIZE = [(128, 128)]


def sap(*rows: tuple[float, float, float, float, float], threshold: float = 10.0) -> float:
    table = np.array(rows, float).reshape(-1, 5)
    return structural_ap([(table[:, :4], table[:, 4])], [TRUE], SIZE, threshold)


def test_structural_ap_by_hand() -> None:
    first, second, wrong = (0, 0, 100, 0), (100, 50, 0, 50), (60, 90, 10, 90)
    assert sap((*first, 0.9), (*second, 0.8)) == 1.0
    assert sap((*first, 0.9)) == 0.5
    assert sap() == 0.0
    assert sap((*wrong, 0.9)) == 0.0
    # Right, wrong, right: precision 1 up to half, then 2/3.
    assert sap((*first, 0.9), (*wrong, 0.8), (*second, 0.7)) == pytest.approx(0.5 + 0.5 * 2 / 3)
    # Wrong first: 1/2 and 2/3, of which the envelope is 2/3 throughout.
    assert sap((*wrong, 0.9), (*first, 0.8), (*second, 0.7)) == pytest.approx(2 / 3)


def test_structural_ap_takes_each_true_segment_once() -> None:
    assert sap((0, 0, 100, 0, 0.9), (0, 1, 100, 0, 0.8)) == 0.5


@pytest.mark.parametrize(("shift", "expected"), [(2.2, 0.5), (2.3, 0.0)])
def test_structural_ap_sums_squares_over_both_endpoints(shift: float, expected: float) -> None:
    """Both ends off by s: 2 s^2, against 10."""
    assert sap((0, shift, 100, shift, 0.9)) == expected


def test_structural_ap_is_in_128ths_of_the_image() -> None:
    found = (np.array([[0, 0, 400.0, 8]]), np.array([0.9]))
    true = [np.array([[0, 0, 400.0, 0]])]
    assert structural_ap([found], true, [(512, 512)], 5.0) == 1.0  # 8 px are 2 of 128: 4 < 5
    assert structural_ap([found], true, [(256, 512)], 5.0) == 0.0  # 8 px are 4 of 128: 16


def test_structural_ap_orders_scores_over_all_images() -> None:
    wrong, right = np.array([[60.0, 90, 10, 90]]), np.array([[0.0, 0, 100, 0]])
    found = [(wrong, np.array([0.9])), (right, np.array([0.5]))]
    assert structural_ap(found, [right, right], SIZE * 2, 10.0) == pytest.approx(0.5 * 0.5)
    assert structural_ap(found[::-1], [right, right], SIZE * 2, 10.0) == pytest.approx(0.5 * 0.5)


def test_nothing_reported_where_nothing_is_true_is_right() -> None:
    """Per image: nothing of nothing; something of nothing; nothing of something."""
    counts = np.array([[0, 0, 0, 0], [0, 7, 0, 0], [0, 0, 0, 7]])
    assert rates(counts).tolist() == [[1, 1, 1], [0, 0, 0], [0, 0, 0]]
