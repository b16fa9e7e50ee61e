"""Evaluation on images whose cables are known as lines: structural AP, and what is found of each cable."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np

from lsnet.evaluation.metrics import distance_to, structural_ap
from lsnet.evaluation.pixels import used
from lsnet.evaluation.rasterize import confidence_map

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from lsnet.evaluation.pixels import LineDetector, Use
    from lsnet.synth.dataset import SampleSource

    Float = NDArray[np.float64]

SAP_THRESHOLDS = (5.0, 10.0, 15.0)
TOLERANCE_PX = 3.0
FOUND_SHARE = 0.8  # of a cable's length that must be covered for it not to be missed
LEAST_GAP_PX = 8.0
LEAST_CABLE_PX = 16.0  # a shorter piece of a cable, in the corner of an image, is not counted


@dataclass(frozen=True, slots=True)
class CableReport:
    """What was found of known cables at one least score.

    sap5 to sap15: structural AP of the ends of lines, over all scores and whatever is used; covered_share: of
    the cables' length; missed_share: of cables, less than 80 % of whose length is covered; gaps_per_cable:
    uncovered stretches of 8 px or more between covered ones; false_px: drawn length beside any cable, mean
    per image; recalled_images and false_images: shares of the images with and without cables in which
    something is reported, None where there are none.
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
            return "no such" if value is None else f"{value:.1%}"

        return (
            f"{self.images} drawn images with {self.cables} cables, {self.use}: "
            f"sAP5/10/15 {self.sap5:.3f} {self.sap10:.3f} {self.sap15:.3f}; at score {self.min_score:g} "
            f"{self.covered_share:.1%} of the length covered, {self.missed_share:.1%} of cables missed, "
            f"{self.gaps_per_cable:.2f} gaps a cable, {self.false_px:.0f} px beside cables an image; "
            f"reported in {share(self.recalled_images)} of images with cables, "
            f"{share(self.false_images)} of images without"
        )

    def to_dict(self) -> dict[str, object]:
        """Plain values for JSON."""
        return asdict(self)


@dataclass(frozen=True, slots=True)
class CableFound:
    """Of one cable: its length in the image, how much of it is covered, and the gaps within."""

    length_px: float
    covered_px: float
    gaps: int


def evaluate_cables(
    finder: LineDetector,
    samples: SampleSource,
    count: int,
    *,
    min_score: float,
    use: Use = "segments",
    on_image: Callable[[], None] = lambda: None,
) -> CableReport:
    """Report of the first `count` samples. The finder must tell all from score 0.05 up."""
    size = (samples.size, samples.size)
    found: list[CableFound] = []
    detected, truth, false_px, is_reported, has_cables = [], [], [], [], []
    for i in range(count):
        sample = samples[i]
        whole = [_inside(line, size) for line in sample.lines]
        cables = [cable for cable in whole if len(cable) > LEAST_CABLE_PX]
        detections = finder.detect([sample.image])[0]
        said = confidence_map(used(detections, use)) >= max(min_score, 1e-6)
        found += cables_found(said, cables)
        false_px.append(int((said & (distance_to(_drawn(cables, size)) > TOLERANCE_PX)).sum()))
        is_reported.append(bool(said.any()))
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


def cables_found(said: NDArray[np.bool_], cables: Sequence[Float]) -> list[CableFound]:
    """What of each cable, given as points 1 px apart (K, 2), lies within 3 px of what is said (H, W)."""
    near = distance_to(said) <= TOLERANCE_PX
    found = []
    for cable in cables:
        column, row = np.floor(cable).astype(int).T
        is_covered = near[np.clip(row, 0, near.shape[0] - 1), np.clip(column, 0, near.shape[1] - 1)]
        found.append(CableFound(float(len(cable)), float(is_covered.sum()), _gaps(is_covered)))
    return found


def _gaps(is_covered: NDArray[np.bool_]) -> int:
    """Uncovered runs between covered places, points 1 px apart."""
    at = np.flatnonzero(is_covered)
    return int((np.diff(at) - 1 >= LEAST_GAP_PX).sum())


def _inside(line: Float, size: tuple[int, int]) -> Float:
    """(K, 2) points 1 px apart along what of a polyline lies in the image."""
    steps = np.hypot(*np.diff(line, axis=0).T)
    along = np.concatenate([[0], np.cumsum(steps)])
    at = np.arange(0.5, along[-1])
    points = np.stack([np.interp(at, along, line[:, k]) for k in (0, 1)], axis=1)
    is_inside = (points >= 0).all(axis=1) & (points < np.array(size[::-1])).all(axis=1)
    return points[is_inside]


def _drawn(cables: Sequence[Float], size: tuple[int, int]) -> NDArray[np.bool_]:
    mask = np.zeros(size, bool)
    for cable in cables:
        column, row = np.floor(cable).astype(int).T
        mask[row, column] = True
    return mask


def _chords(lines: Sequence[NDArray[np.floating]]) -> Float:
    """(N, 4) first and last points of lines."""
    return np.array([[*points[0], *points[-1]] for points in lines], float).reshape(-1, 4)


def _mean(values: Sequence[float]) -> float | None:
    return float(np.mean(values)) if len(values) else None
