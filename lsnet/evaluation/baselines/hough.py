"""The classical approach of the paper's introduction: edges, Hough transform, and lines that are parallel."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import cv2
import numpy as np

from lsnet.evaluation.baselines.lengths import by_length
from lsnet.geometry import length

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lsnet.arrays import Floats32, ImageArray
    from lsnet.segments import Detections

CANNY = (50, 150)  # thresholds of the gradient
VOTES, MIN_LENGTH_PX, MAX_GAP_PX = 50, 40, 8  # of the progressive probabilistic Hough transform
PARALLEL_DEG = 5.0  # of the direction along which most length lies


class Hough:
    """Canny, Hough transform, parallel lines; reports each segment also as a line, scored by length."""

    min_score: ClassVar[float] = 0.5  # 69 px

    def detect(self, images: Sequence[ImageArray]) -> list[Detections]:
        """Detect in uint8 (H, W, 3) RGB images, in the pixels of each."""
        return [self._detect(image) for image in images]

    @staticmethod
    def _detect(image: ImageArray) -> Detections:
        edges = cv2.Canny(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), *CANNY)
        found = cv2.HoughLinesP(
            edges, 1, np.pi / 180, VOTES, minLineLength=MIN_LENGTH_PX, maxLineGap=MAX_GAP_PX
        )
        ends = np.zeros((0, 4), np.float32) if found is None else found.reshape(-1, 4) + np.float32(0.5)
        return by_length(parallel(ends), (image.shape[0], image.shape[1]))


def parallel(ends: Floats32) -> Floats32:
    """Return the segments (N, 4) along the direction in which most of their length lies."""
    if not len(ends):
        return ends
    directions = np.degrees(np.arctan2(ends[:, 3] - ends[:, 1], ends[:, 2] - ends[:, 0])) % 180
    apart = np.abs(directions[:, None] - directions[None])
    is_parallel = np.minimum(apart, 180 - apart) <= PARALLEL_DEG
    best = int((is_parallel @ length(ends)).argmax())
    return np.asarray(ends[is_parallel[best]], np.float32)
