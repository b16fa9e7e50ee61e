"""Generic line detectors by length: what they tell, with scores that make thresholds length filters.

The score grows with the logarithm of the length, from 0 at 4 px to 1 at the image's diagonal, so that evenly
spaced thresholds cover every length filter, and the best F1 over thresholds is that of the best one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from lsnet.geometry import length
from lsnet.segments import Detections, Lines, Segments

if TYPE_CHECKING:
    from numpy.typing import NDArray

SHORTEST_PX = 4.0


def by_length(ends: NDArray[np.float32], size: tuple[int, int]) -> Detections:
    """Segments (N, 4) of an image of (height, width), each of them a line too."""
    scores = score_of_length(length(ends), size)
    pieces = tuple(ends.reshape(-1, 2, 2))
    line_of = np.arange(len(ends), dtype=np.int32)
    return Detections(Segments(ends, scores, size), Lines(pieces, scores, size), line_of)


def score_of_length(length_px: NDArray[np.float32], size: tuple[int, int]) -> NDArray[np.float32]:
    """The score of segments of some lengths in an image of (height, width)."""
    share = np.log(np.maximum(length_px, SHORTEST_PX) / SHORTEST_PX) / np.log(np.hypot(*size) / SHORTEST_PX)
    return np.clip(share, 0, 1).astype(np.float32)
