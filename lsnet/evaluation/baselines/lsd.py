"""OpenCV's Line Segment Detector (von Gioi et al.), a rival that was not trained."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import cv2
import numpy as np

from lsnet.evaluation.baselines.lengths import by_length

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from lsnet.segments import Detections


class LSD:
    """Each segment is told as a line too, with its length for a score."""

    min_score: ClassVar[float] = 0.5  # 69 px

    def __init__(self) -> None:
        self._lsd = cv2.createLineSegmentDetector()

    def detect(self, images: Sequence[NDArray[np.uint8]]) -> list[Detections]:
        """Segments of uint8 (H, W, 3) RGB images, in their pixels."""
        return [self._detect(image) for image in images]

    def _detect(self, image: NDArray[np.uint8]) -> Detections:
        found = self._lsd.detect(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY))[0]
        ends = np.zeros((0, 4), np.float32) if found is None else found.reshape(-1, 4) + np.float32(0.5)
        return by_length(ends, (image.shape[0], image.shape[1]))
