"""Scores as in the paper (Section IV-A): segmentation maps from segments; ARR, APR and F1 without tolerance.

Precision, recall and F1 are computed per image and averaged, so the F1 is not the harmonic mean of the other
two. Pooled scores are computed from the counts of the whole set.

The map holds the segments that are detected: those of the detector's own threshold, unless another is given.
The paper leaves the width of the Gaussian open; the default is that of scikit-image, which it names.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, Protocol

import numpy as np

from lsnet.evaluation.datasets import images_of, load_mask
from lsnet.evaluation.metrics import rates
from lsnet.evaluation.pixels import segments_of
from lsnet.evaluation.rasterize import SIGMA_PX, confidence_map, otsu_mask, smoothed
from lsnet.images import load_rgb

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from lsnet.arrays import Floats32, ImageArray, Mask
    from lsnet.evaluation.pixels import LineDetector, Use
    from lsnet.segments import Segments

    Binarised = Literal["otsu", "0.5"]

PLAIN_THRESHOLD = 0.5


@dataclass(frozen=True, slots=True)
class Way:
    """How a map becomes pixels: the width of the segments, None for a map of pixels, and the threshold."""

    width_px: int | None
    binarised: Binarised

    def __str__(self) -> str:
        width = "" if self.width_px is None else f"{self.width_px} px wide, "
        if self.binarised == "0.5":
            return f"{width}score {PLAIN_THRESHOLD:g}"
        return f"{width}Gaussian, Otsu" if self.width_px else "Otsu"


_HOW: tuple[Binarised, ...] = ("otsu", "0.5")
WAYS = tuple(Way(width, how) for how in _HOW for width in (1, 2, 3, 4, 5))
COMPARED = (Way(2, "otsu"), Way(3, "otsu"))  # LS-Net-W2 and -W3 of the paper's comparison
ABLATED = (Way(1, "0.5"),)  # its ablation
OF_PIXELS = Way(None, "otsu")  # a rival that classifies pixels: no segments, no Gaussian


@dataclass(frozen=True, slots=True)
class PaperScore:
    """Scores of a set in one way: means over images, and pooled."""

    folder: str
    images: int
    width_px: int | None
    binarised: Binarised
    min_score: float
    sigma_px: float
    apr: float
    arr: float
    f1: float
    pooled_precision: float
    pooled_recall: float
    pooled_f1: float

    def __str__(self) -> str:
        means = f"APR {self.apr:.4f}, ARR {self.arr:.4f}, F1 {self.f1:.4f}"
        pooled = f"P {self.pooled_precision:.4f}, R {self.pooled_recall:.4f}, F1 {self.pooled_f1:.4f}"
        way = Way(self.width_px, self.binarised)
        return f"{self.folder}: {self.images} images, {way}: {means} (pooled {pooled})"


class PixelClassifier(Protocol):
    """A rival that scores pixels instead of reporting segments."""

    def confidence(self, image: ImageArray) -> Floats32:
        """Return (H, W) scores from 0 to 1 of uint8 (H, W, 3) RGB."""
        ...


@dataclass(frozen=True, slots=True)
class PaperProtocol:
    """Options of the paper's scores.

    Attributes:
        ways: Widths and thresholds to score.
        min_score: Score from which a segment is detected.
        sigma_px: Width of the Gaussian before Otsu's threshold.
        use: Score segments, as the paper does, or lines.
    """

    ways: Sequence[Way] = WAYS
    min_score: float = PLAIN_THRESHOLD
    sigma_px: float = SIGMA_PX
    use: Use = "segments"

    def masks(self, detector: LineDetector, image: ImageArray) -> list[Mask]:
        """Return the (H, W) pixels classified as cable, in each way."""
        found = segments_of(detector.detect([image])[0], self.use).above(self.min_score)
        return [segmentation(found, way, self.sigma_px) for way in self.ways]


def segmentation(segments: Segments, way: Way, sigma_px: float = SIGMA_PX) -> Mask:
    """Return (H, W) pixels classified as cable: drawn, then smoothed and cut by Otsu, or cut at 0.5."""
    drawn = confidence_map(segments, way.width_px or 1)
    return otsu_mask(smoothed(drawn, sigma_px)) if way.binarised == "otsu" else drawn >= PLAIN_THRESHOLD


def evaluate_as_paper(
    detector: LineDetector,
    folder: Path,
    protocol: PaperProtocol | None = None,
    on_image: Callable[[], None] = lambda: None,
) -> list[PaperScore]:
    """Score a folder in each way of the protocol; no scores for a folder without pixel truth.

    Raises:
        LSNetError: The folder has no images, or a truth is missing or has another size.
    """
    protocol = protocol or PaperProtocol()
    return _score(folder, protocol, lambda image: protocol.masks(detector, image), on_image)


def evaluate_pixels_as_paper(
    classifier: PixelClassifier, folder: Path, on_image: Callable[[], None] = lambda: None
) -> list[PaperScore]:
    """Score the map of a pixel classifier, cut by Otsu; no scores for a folder without pixel truth.

    Raises:
        LSNetError: As `evaluate_as_paper`.
    """
    protocol = PaperProtocol(ways=(OF_PIXELS,), min_score=0.0, sigma_px=0.0)
    return _score(folder, protocol, lambda image: [otsu_mask(classifier.confidence(image))], on_image)


def _score(
    folder: Path,
    protocol: PaperProtocol,
    masks_of: Callable[[ImageArray], list[Mask]],
    on_image: Callable[[], None],
) -> list[PaperScore]:
    kind, files = images_of(folder)
    if kind == "plain":
        return []
    counts = np.zeros((len(files), len(protocol.ways), 4), np.int64)
    for i, path in enumerate(files):
        image = load_rgb(path)
        mask = load_mask(kind, path, image.shape[:2])
        for k, predicted in enumerate(masks_of(image)):
            right = int((predicted & mask).sum())
            counts[i, k] = right, predicted.sum(), right, mask.sum()
        on_image()
    means, pooled = rates(counts).mean(axis=0), rates(counts.sum(axis=0))
    return [
        PaperScore(
            str(folder),
            len(files),
            way.width_px,
            way.binarised,
            protocol.min_score,
            protocol.sigma_px,
            *means[k].tolist(),
            *pooled[k].tolist(),
        )
        for k, way in enumerate(protocol.ways)
    ]
