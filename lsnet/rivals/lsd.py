"""OpenCV's Line Segment Detector (von Gioi et al.), with length for a score.

Score thresholds are then length filters: 1 - exp(-length / 100 px), so that the thresholds from 0.05 to 0.95
are lengths from 5 to 300 px, and the best F1 over thresholds is that of the best length filter.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import cv2
import numpy as np

from lsnet.geometry import length
from lsnet.segments import Detections, Lines, Segments

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

SCORE_LENGTH_PX = 100.0


class LSD:
    """Each segment is told as a line too."""

    min_score: ClassVar[float] = 0.5  # 69 px

    def __init__(self) -> None:
        self._lsd = cv2.createLineSegmentDetector()

    def detect(self, images: Sequence[NDArray[np.uint8]]) -> list[Detections]:
        """Segments of uint8 (H, W, 3) RGB images, in their pixels."""
        return [self._detect(image) for image in images]

    def _detect(self, image: NDArray[np.uint8]) -> Detections:
        size = (image.shape[0], image.shape[1])
        found = self._lsd.detect(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY))[0]
        ends = np.zeros((0, 4), np.float32) if found is None else found.reshape(-1, 4) + np.float32(0.5)
        scores = (1 - np.exp(-length(ends) / SCORE_LENGTH_PX)).astype(np.float32)
        pieces = tuple(ends.reshape(-1, 2, 2))
        line_of = np.arange(len(ends), dtype=np.int32)
        return Detections(Segments(ends, scores, size), Lines(pieces, scores, size), line_of)
