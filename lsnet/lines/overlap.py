"""Where lines lie on other lines."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

from lsnet.geometry import angle_between

if TYPE_CHECKING:
    from lsnet.arrays import Floats, Indices, Mask
    from lsnet.lines.polylines import Polylines

MAX_ANGLE_DEG = 15.0
STEP_PX, OTHER_STEP_PX = 3.0, 1.5
NEAREST = 16  # pieces of other lines that are compared with a piece, for each STEP_PX of reach


@dataclass(frozen=True, slots=True, eq=False)
class Overlaps:
    """Pieces of C lines, and which of the other lines they lie on.

    Attributes:
        line_of: (P,) number of the line of each piece.
        pieces, others: (Q,) a piece, in ascending order, and the number of another line that it lies on.
        counts: (C,) pieces of each line.
    """

    line_of: Indices
    pieces: Indices
    others: Indices
    counts: Indices

    def shares(self) -> Floats:
        """Return (C,) shares of the length of lines that lie on any of the others."""
        on = self.line_of[np.unique(self.pieces)]
        return np.bincount(on, minlength=len(self.counts)) / np.maximum(self.counts, 1)

    def share_of(self, line: int, is_other: Mask) -> float:
        """Return the share of the length of one line that lies on any of the others chosen."""
        first, last = np.searchsorted(self.line_of, [line, line + 1])  # pieces are in the order of lines
        begin, end = np.searchsorted(self.pieces, [first, last])
        on = self.pieces[begin:end][is_other[self.others[begin:end]]]
        return float(len(np.unique(on)) / max(self.counts[line], 1))


def find_overlaps(lines: Polylines, others: Polylines, reach_px: float) -> Overlaps:
    """Find where lines lie on others, in their direction.

    Args:
        lines: In pixels.
        others: Likewise.
        reach_px: Greatest distance of the middle of a piece from the line that it lies on.
    """
    middles, angles, line_of = _pieces(lines, STEP_PX)
    places, other_angles, other_of = _pieces(others, OTHER_STEP_PX)
    counts = np.bincount(line_of, minlength=len(lines))
    if not len(places) or not len(middles):
        none = np.zeros(0, np.intp)
        return Overlaps(line_of, none, none, counts)
    count = NEAREST * max(1, round(reach_px / STEP_PX))
    near = np.asarray(cKDTree(places).query(middles, k=count, distance_upper_bound=reach_px)[1])
    pieces, column = np.nonzero(near < len(places))
    found = near[pieces, column]
    is_along = angle_between(other_angles[found], angles[pieces]) <= np.radians(MAX_ANGLE_DEG)
    return Overlaps(line_of, pieces[is_along], other_of[found[is_along]], counts)


def _pieces(lines: Polylines, step_px: float) -> tuple[Floats, Floats, Indices]:
    """Middles of pieces of about `step_px`, their angles, and the number of the line of each."""
    if not len(lines):
        return np.zeros((0, 2)), np.zeros(0), np.zeros(0, np.intp)
    counts = np.maximum(np.round(lines.lengths_px / step_px).astype(np.intp), 1)
    line_of = np.repeat(np.arange(len(lines)), counts)
    place = np.arange(len(line_of)) - np.repeat(np.cumsum(counts) - counts, counts)
    step = (lines.lengths_px / counts)[line_of]
    start, end = lines.at(line_of, place * step), lines.at(line_of, (place + 1) * step)
    along = end - start
    return (start + end) / 2, np.arctan2(along[:, 1], along[:, 0]), line_of
