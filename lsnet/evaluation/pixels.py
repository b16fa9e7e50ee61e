"""Evaluation on a folder of images: pixel scores where there is truth, reports where there is none."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Literal, Protocol

import numpy as np

from lsnet.evaluation.datasets import images_of, load_truth
from lsnet.evaluation.metrics import THRESHOLDS, PixelScore, pixel_counts, pixel_scores
from lsnet.evaluation.rasterize import confidence_map
from lsnet.images import load_rgb

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from lsnet.segments import Detections, Segments

    Use = Literal["segments", "lines"]

REPORT_THRESHOLDS = (0.3, 0.5, 0.7, 0.9)


class LineDetector(Protocol):
    """What can be evaluated: a `Detector`, or a rival."""

    def detect(self, images: Sequence[NDArray[np.uint8]]) -> list[Detections]:
        """What is found in each uint8 (H, W, 3) RGB image, in its own pixels."""
        ...


def used(detections: Detections, use: Use) -> Segments:
    """What counts of the detections: the raw segments, or the pieces of the lines."""
    return detections.segments if use == "segments" else detections.lines.pieces()


@dataclass(frozen=True, slots=True)
class PixelReport:
    """A set with pixel truth at one tolerance: the best threshold (ODS), and the one asked for."""

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

    def to_dict(self) -> dict[str, object]:
        """Plain values for JSON."""
        return asdict(self)


@dataclass(frozen=True, slots=True)
class ShareReport:
    """A set without pixel truth: the share of its images in which something is reported, by least score."""

    folder: str
    images: int
    reported: dict[float, float]
    use: Use = "segments"

    def __str__(self) -> str:
        shares = ", ".join(f"{share:.1%} at score {score:g}" for score, share in self.reported.items())
        return f"{self.folder}: {self.images} images, with a reported {self.use[:-1]}: {shares}"

    def to_dict(self) -> dict[str, object]:
        """Plain values for JSON."""
        return asdict(self)


def evaluate(
    detector: LineDetector,
    folder: Path,
    *,
    min_score: float,
    use: Use = "segments",
    tolerances_px: Sequence[float] = (1.0, 3.0, 4.87),
    on_image: Callable[[], None] = lambda: None,
) -> list[PixelReport | ShareReport]:
    """Reports of one folder, by tolerance. The detector must tell all from score 0.05 up.

    Raises LSNetError when the folder holds no images, or a truth is missing or of another size.
    """
    kind, files = images_of(folder)
    thresholds = np.append(THRESHOLDS, min_score)
    counts: dict[float, list[object]] = {tolerance: [] for tolerance in tolerances_px}
    best_scores = []
    for path in files:
        segments = used(detector.detect([load_rgb(path)])[0], use)
        best_scores.append(float(segments.scores.max(initial=-1.0)))  # -1: nothing told
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
