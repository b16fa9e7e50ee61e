"""OpenCV's Line Segment Detector (von Gioi et al.), a rival without training."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import cv2
import numpy as np

from lsnet.evaluation.baselines.lengths import by_length

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lsnet.arrays import ImageArray
    from lsnet.segments import Detections


class LSD:
    """Reports each segment also as a line, scored by length."""

    min_score: ClassVar[float] = 0.5  # 69 px

    def __init__(self) -> None:
        self._lsd = cv2.createLineSegmentDetector()

    def detect(self, images: Sequence[ImageArray]) -> list[Detections]:
        """Detect in uint8 (H, W, 3) RGB images, in the pixels of each."""
        return [self._detect(image) for image in images]

    def _detect(self, image: ImageArray) -> Detections:
        found = self._lsd.detect(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY))[0]
        ends = np.zeros((0, 4), np.float32) if found is None else found.reshape(-1, 4) + np.float32(0.5)
        return by_length(ends, (image.shape[0], image.shape[1]))
