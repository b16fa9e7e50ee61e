"""Scores by length for line detectors without scores, so that a score threshold is a length filter.

The score is 1 - exp(-length / 100 px): thresholds from 0.05 to 0.95 are lengths from 5 to 300 px, and the
best F1 over thresholds is that of the best length filter.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from lsnet.geometry import length
from lsnet.segments import Detections, Lines, Segments

if TYPE_CHECKING:
    from lsnet.arrays import Floats32

SCORE_LENGTH_PX = 100.0


def by_length(ends: Floats32, size: tuple[int, int]) -> Detections:
    """Return segments (N, 4) of an image of (height, width), each also as a line, scored by length."""
    scores = (1 - np.exp(-length(ends) / SCORE_LENGTH_PX)).astype(np.float32)
    pieces = tuple(ends.reshape(-1, 2, 2))
    line_of = np.arange(len(ends), dtype=np.int32)
    return Detections(Segments(ends, scores, size), Lines(pieces, scores, size), line_of)
