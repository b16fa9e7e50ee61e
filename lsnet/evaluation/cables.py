"""Evaluation on images whose cables are known as lines: structural AP, and the coverage of each cable."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from lsnet.evaluation.metrics import distance_to, structural_ap
from lsnet.evaluation.pixels import segments_of
from lsnet.evaluation.rasterize import confidence_map

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from lsnet.arrays import Floats, Mask, RealArray
    from lsnet.evaluation.pixels import LineDetector, Use
    from lsnet.synth.dataset import SampleSource


SAP_THRESHOLDS = (5.0, 10.0, 15.0)
TOLERANCE_PX = 3.0
FOUND_SHARE = 0.8  # of its length; a cable covered less counts as missed
MIN_GAP_PX = 8.0
MIN_CABLE_PX = 16.0  # shorter pieces, in corners of images, are not counted


@dataclass(frozen=True, slots=True)
class CableReport:
    """Scores on images with known cables at one minimum score.

    Attributes:
        sap5, sap10, sap15: Structural AP of the ends of lines, over all scores, also when segments are used.
        covered_share: Share of the cables' length with a detection within 3 px.
        missed_share: Share of the cables that are covered over less than 80 % of their length.
        gaps_per_cable: Uncovered stretches of 8 px or more between covered ones.
        false_px: Detected length farther than 3 px from any cable, mean per image.
        recalled_images: Share of the images with cables that have a report, None without such images.
        false_images: Share of the images without cables that have a report, None without such images.
    """

    images: int
    cables: int
    use: Use
    min_score: float
    sap5: float
    sap10: float
    sap15: float
    covered_share: float
    missed_share: float
    gaps_per_cable: float
    false_px: float
    recalled_images: float | None
    false_images: float | None

    def __str__(self) -> str:
        def share(value: float | None) -> str:
            return "no" if value is None else f"{value:.1%}"

        return (
            f"{self.images} synthetic images with {self.cables} cables, {self.use}: "
            f"sAP5/10/15 {self.sap5:.3f} {self.sap10:.3f} {self.sap15:.3f}; at score {self.min_score:g} "
            f"{self.covered_share:.1%} of the length covered, {self.missed_share:.1%} of cables missed, "
            f"{self.gaps_per_cable:.2f} gaps per cable, {self.false_px:.0f} false px per image; "
            f"reported in {share(self.recalled_images)} of images with cables, "
            f"{share(self.false_images)} of images without"
        )


@dataclass(frozen=True, slots=True)
class CableCoverage:
    """Length of one cable in the image, the covered part of it, and the number of gaps."""

    length_px: float
    covered_px: float
    gaps: int


def evaluate_cables(
    detector: LineDetector,
    samples: SampleSource,
    count: int,
    *,
    min_score: float,
    use: Use = "segments",
    on_image: Callable[[], None] = lambda: None,
) -> CableReport:
    """Evaluate on the first `count` samples. The detector must report everything from a score of 0.05."""
    size = (samples.size, samples.size)
    found: list[CableCoverage] = []
    detected, truth, false_px, is_reported, has_cables = [], [], [], [], []
    for i in range(count):
        sample = samples[i]
        whole = [_inside(line, size) for line in sample.lines]
        cables = [cable for cable in whole if len(cable) > MIN_CABLE_PX]
        detections = detector.detect([sample.image])[0]
        is_detected = confidence_map(segments_of(detections, use)) >= max(min_score, 1e-6)
        found += cable_coverage(is_detected, cables)
        false_px.append(int((is_detected & (distance_to(_drawn(cables, size)) > TOLERANCE_PX)).sum()))
        is_reported.append(bool(is_detected.any()))
        has_cables.append(bool(cables))
        detected.append((_chords(detections.lines.points), detections.lines.scores))
        truth.append(_chords(cables))
        on_image()
    saps = [structural_ap(detected, truth, [size] * count, threshold) for threshold in SAP_THRESHOLDS]
    with_cables = np.array(has_cables)
    return CableReport(
        images=count,
        cables=len(found),
        use=use,
        min_score=min_score,
        sap5=saps[0],
        sap10=saps[1],
        sap15=saps[2],
        covered_share=sum(c.covered_px for c in found) / max(sum(c.length_px for c in found), 1e-9),
        missed_share=_mean([c.covered_px < FOUND_SHARE * c.length_px for c in found]) or 0.0,
        gaps_per_cable=_mean([c.gaps for c in found]) or 0.0,
        false_px=float(np.mean(false_px)),
        recalled_images=_mean(np.array(is_reported)[with_cables].tolist()),
        false_images=_mean(np.array(is_reported)[~with_cables].tolist()),
    )


def cable_coverage(is_detected: Mask, cables: Sequence[Floats]) -> list[CableCoverage]:
    """Measure how much of each cable (K, 2), points 1 px apart, is within 3 px of a detected pixel (H, W)."""
    near = distance_to(is_detected) <= TOLERANCE_PX
    found = []
    for cable in cables:
        column, row = np.floor(cable).astype(int).T
        is_covered = near[np.clip(row, 0, near.shape[0] - 1), np.clip(column, 0, near.shape[1] - 1)]
        found.append(CableCoverage(float(len(cable)), float(is_covered.sum()), _gaps(is_covered)))
    return found


def _gaps(is_covered: Mask) -> int:
    """Count uncovered runs between covered points, 1 px apart."""
    at = np.flatnonzero(is_covered)
    return int((np.diff(at) - 1 >= MIN_GAP_PX).sum())


def _inside(line: Floats, size: tuple[int, int]) -> Floats:
    """(K, 2) points 1 px apart along the part of a polyline inside the image."""
    steps = np.hypot(*np.diff(line, axis=0).T)
    along = np.concatenate([[0], np.cumsum(steps)])
    at = np.arange(0.5, along[-1])
    points = np.stack([np.interp(at, along, line[:, k]) for k in (0, 1)], axis=1)
    is_inside = (points >= 0).all(axis=1) & (points < np.array(size[::-1])).all(axis=1)
    return points[is_inside]


def _drawn(cables: Sequence[Floats], size: tuple[int, int]) -> Mask:
    mask = np.zeros(size, bool)
    for cable in cables:
        column, row = np.floor(cable).astype(int).T
        mask[row, column] = True
    return mask


def _chords(lines: Sequence[RealArray]) -> Floats:
    """(N, 4) first and last points of the lines."""
    return np.array([[*points[0], *points[-1]] for points in lines], float).reshape(-1, 4)


def _mean(values: Sequence[float]) -> float | None:
    return float(np.mean(values)) if len(values) else None
