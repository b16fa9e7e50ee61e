"""Scores as in the paper (Section IV-A): segmentation maps from segments; ARR, APR and F1 without tolerance.

Precision, recall and F1 are computed per image and averaged, so the F1 is not the harmonic mean of the other
two. Pooled scores are computed from the counts of the whole set.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from lsnet.evaluation.datasets import images_of, load_truth
from lsnet.evaluation.metrics import rates
from lsnet.evaluation.pixels import segments_of
from lsnet.evaluation.rasterize import confidence_map, otsu_mask, smoothed
from lsnet.images import load_rgb

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from lsnet.arrays import Mask
    from lsnet.evaluation.pixels import LineDetector, Use
    from lsnet.segments import Segments

    Binarised = Literal["otsu", "0.5"]

WIDTHS_PX = (1, 2, 3, 4, 5)
PLAIN_THRESHOLD = 0.5


@dataclass(frozen=True, slots=True)
class PaperScore:
    """Scores of a set at one line width and one way of binarisation: means over images, and pooled."""

    folder: str
    images: int
    width_px: int
    binarised: Binarised
    apr: float
    arr: float
    f1: float
    pooled_precision: float
    pooled_recall: float
    pooled_f1: float

    def __str__(self) -> str:
        how = "Gaussian, Otsu" if self.binarised == "otsu" else f"score {PLAIN_THRESHOLD:g}"
        means = f"APR {self.apr:.4f}, ARR {self.arr:.4f}, F1 {self.f1:.4f}"
        pooled = f"P {self.pooled_precision:.4f}, R {self.pooled_recall:.4f}, F1 {self.pooled_f1:.4f}"
        return (
            f"{self.folder}: {self.images} images, {self.width_px} px wide, {how}: {means} (pooled {pooled})"
        )


def segmentation(segments: Segments, width_px: int, binarised: Binarised) -> Mask:
    """Return (H, W) pixels classified as cable: drawn, then smoothed and cut by Otsu, or cut at 0.5."""
    drawn = confidence_map(segments, width_px)
    return otsu_mask(smoothed(drawn)) if binarised == "otsu" else drawn >= PLAIN_THRESHOLD


def evaluate_as_paper(
    detector: LineDetector,
    folder: Path,
    *,
    use: Use = "segments",
    on_image: Callable[[], None] = lambda: None,
) -> list[PaperScore]:
    """Score a folder for each width and way of binarisation; no scores for a folder without pixel truth.

    Raises:
        LSNetError: The folder has no images, or a truth is missing or has another size.
    """
    kind, files = images_of(folder)
    if kind == "plain":
        return []
    ways: list[tuple[int, Binarised]] = [(w, how) for how in ("otsu", "0.5") for w in WIDTHS_PX]
    counts = np.zeros((len(files), len(ways), 4), np.int64)
    for i, path in enumerate(files):
        segments = segments_of(detector.detect([load_rgb(path)])[0], use)
        mask = load_truth(kind, path, segments.image_size).mask
        for k, (width_px, how) in enumerate(ways):
            predicted = segmentation(segments, width_px, how)
            right = int((predicted & mask).sum())
            counts[i, k] = right, predicted.sum(), right, mask.sum()
        on_image()
    means, pooled = rates(counts).mean(axis=0), rates(counts.sum(axis=0))
    return [
        PaperScore(str(folder), len(files), width_px, how, *means[k].tolist(), *pooled[k].tolist())
        for k, (width_px, how) in enumerate(ways)
    ]
