"""Evaluation on a folder of images: pixel scores if there is truth, else shares of images with a report."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, Protocol

import numpy as np

from lsnet.evaluation.datasets import images_of, load_truth
from lsnet.evaluation.metrics import THRESHOLDS, PixelScore, pixel_counts, pixel_scores
from lsnet.evaluation.rasterize import confidence_map
from lsnet.images import load_rgb

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from lsnet.arrays import ImageArray
    from lsnet.segments import Detections, Segments

    Use = Literal["segments", "lines"]

REPORT_THRESHOLDS = (0.3, 0.5, 0.7, 0.9)


class LineDetector(Protocol):
    """Anything that can be evaluated: a `Detector` or a rival."""

    def detect(self, images: Sequence[ImageArray]) -> list[Detections]:
        """Detect in uint8 (H, W, 3) RGB images, in the pixels of each."""
        ...


def segments_of(detections: Detections, use: Use) -> Segments:
    """Return what is evaluated: the raw segments, or the straight pieces of the lines."""
    return detections.segments if use == "segments" else detections.lines.pieces()


@dataclass(frozen=True, slots=True)
class PixelReport:
    """Scores of a set with pixel truth at one tolerance: at the best threshold (ODS), and at `min_score`."""

    folder: str
    images: int
    tolerance_px: float
    ods: PixelScore
    at_min_score: PixelScore

    def __str__(self) -> str:
        found = f"{self.folder}: {self.images} images, within {self.tolerance_px:g} px: "
        return found + ", ".join(
            f"{name} F1 {s.f1:.4f} (P {s.precision:.4f}, R {s.recall:.4f}) at score {s.threshold:.2f}"
            for name, s in (("ODS", self.ods), ("own", self.at_min_score))
        )


@dataclass(frozen=True, slots=True)
class ShareReport:
    """Share of the images of a set without pixel truth that have a report, by minimum score."""

    folder: str
    images: int
    reported: dict[float, float]
    use: Use = "segments"

    def __str__(self) -> str:
        shares = ", ".join(f"{share:.1%} at score {score:g}" for score, share in self.reported.items())
        return f"{self.folder}: {self.images} images, with a reported {self.use[:-1]}: {shares}"


def evaluate(
    detector: LineDetector,
    folder: Path,
    *,
    min_score: float,
    use: Use = "segments",
    tolerances_px: Sequence[float] = (1.0, 3.0, 4.87),
    on_image: Callable[[], None] = lambda: None,
) -> list[PixelReport | ShareReport]:
    """Evaluate on one folder; one report per tolerance, or one for a folder without pixel truth.

    The detector must report everything from a score of 0.05.

    Raises:
        LSNetError: The folder has no images, or a truth is missing or has another size.
    """
    kind, files = images_of(folder)
    thresholds = np.append(THRESHOLDS, min_score)
    counts: dict[float, list[object]] = {tolerance: [] for tolerance in tolerances_px}
    best_scores = []
    for path in files:
        segments = segments_of(detector.detect([load_rgb(path)])[0], use)
        best_scores.append(float(segments.scores.max(initial=-1.0)))  # -1: nothing reported
        if kind != "plain":
            truth, confidence = load_truth(kind, path, segments.image_size), confidence_map(segments)
            for tolerance in tolerances_px:
                counts[tolerance].append(pixel_counts(confidence, truth, tolerance, thresholds))
        on_image()
    if kind == "plain":
        levels = sorted({*REPORT_THRESHOLDS, round(min_score, 4)})
        shares = {t: float(np.mean(np.array(best_scores) >= t)) for t in levels}
        return [ShareReport(str(folder), len(files), shares, use)]
    reports: list[PixelReport | ShareReport] = []
    for tolerance in tolerances_px:
        scores = pixel_scores(np.array(counts[tolerance]), thresholds)
        ods = max(scores[:-1], key=lambda s: s.f1)
        reports.append(PixelReport(str(folder), len(files), tolerance, ods, scores[-1]))
    return reports
