"""The paper's scores by hand: averages over images, and pooled."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest
from skimage.filters import gaussian, threshold_otsu

from lsnet.evaluation.paper import (
    PaperProtocol,
    Way,
    evaluate_as_paper,
    evaluate_pixels_as_paper,
    segmentation,
)
from lsnet.evaluation.rasterize import confidence_map
from lsnet.segments import Detections, Lines, Segments

if TYPE_CHECKING:
    from pathlib import Path

SIZE = (60, 80)


def segment(row: float, score: float) -> Segments:
    return Segments(np.array([[0, row, 79.9, row]], np.float32), np.array([score], np.float32), SIZE)


class FirstOnly:
    """Finds rows 30 and 10 of the dark image, nothing in the bright one."""

    def detect(self, images: list[np.ndarray]) -> list[Detections]:
        both = Segments(
            np.array([[0, 30.5, 79.9, 30.5], [0, 10.5, 79.9, 10.5]], np.float32),
            np.array([0.9, 0.8], np.float32),
            SIZE,
        )
        return [
            Detections(Segments.empty(SIZE) if image[0, 0, 0] else both, Lines.empty(SIZE))
            for image in images
        ]


@pytest.fixture
def two_images(tmp_path: Path) -> Path:
    for name, value in (("a", 0), ("b", 100)):
        for kind in ("images", "masks"):
            (tmp_path / kind).mkdir(exist_ok=True)
        cv2.imwrite(str(tmp_path / f"images/{name}.png"), np.full((*SIZE, 3), value, np.uint8))
        mask = np.zeros(SIZE, np.uint8)
        mask[29:33] = 255
        cv2.imwrite(str(tmp_path / f"masks/{name}.png"), mask)
    return tmp_path


def test_means_are_per_image_and_pooled_scores_over_all(two_images: Path) -> None:
    scores = {(s.width_px, s.binarised): s for s in evaluate_as_paper(FirstOnly(), two_images)}
    assert len(scores) == 10
    one = scores[1, "0.5"]
    # Image a: 80 of 160 drawn are right, 80 of 320 found. Image b: nothing drawn.
    assert (one.images, one.apr, one.arr) == (2, 0.25, 0.125)
    assert one.f1 == pytest.approx((2 * 0.5 * 0.25 / 0.75) / 2)
    assert (one.pooled_precision, one.pooled_recall) == (0.5, 0.125)
    assert one.pooled_f1 == pytest.approx(0.2)
    assert scores[3, "0.5"].arr == 3 * one.arr
    assert "1 px wide, score 0.5: APR 0.2500" in str(one)


def test_only_detected_segments_are_drawn(two_images: Path) -> None:
    """From a score of 0.85 row 30 is left: all 80 drawn are right."""
    protocol = PaperProtocol((Way(1, "otsu"), Way(1, "0.5")), min_score=0.85, sigma_px=0.1)
    for score in evaluate_as_paper(FirstOnly(), two_images, protocol):
        assert (score.apr, score.arr, score.min_score, score.sigma_px) == (0.5, 0.125, 0.85, 0.1)


class Bright:
    """Scores pixels by their row: the four of the cable 1, others below 0.3."""

    def confidence(self, image: np.ndarray) -> np.ndarray:
        rows = np.linspace(0, 0.3, SIZE[0], dtype=np.float32)
        rows[29:33] = 1
        return np.repeat(rows[:, None], SIZE[1], axis=1)


def test_maps_of_pixels_are_cut_by_otsu(two_images: Path) -> None:
    (score,) = evaluate_pixels_as_paper(Bright(), two_images)
    assert (score.width_px, score.binarised, score.apr, score.arr, score.f1) == (None, "otsu", 1, 1, 1)
    assert "images, Otsu: APR 1.0000" in str(score)


def test_folder_without_truth_has_no_paper_scores(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((*SIZE, 3), np.uint8))
    assert evaluate_as_paper(FirstOnly(), tmp_path) == []


def test_binary_maps_use_the_stated_threshold() -> None:
    assert segmentation(segment(30.5, 0.5), Way(1, "0.5")).sum() == 80
    assert not segmentation(segment(30.5, 0.49), Way(1, "0.5")).any()
    two = Segments(
        np.concatenate([segment(10.5, 0.4).endpoints, segment(40.5, 0.9).endpoints]),
        np.array([0.4, 0.9], np.float32),
        SIZE,
    )
    for sigma_px in (1.0, 2.0):
        grey = np.round(gaussian(confidence_map(two, 2), sigma_px, truncate=6) * 255).astype(np.uint8)
        found = segmentation(two, Way(2, "otsu"), sigma_px)
        assert (found != (grey > threshold_otsu(grey))).mean() < 0.01
