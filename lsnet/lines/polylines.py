"""All polylines of an image in one array."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lsnet.arrays import Floats, Indices, RealArray


@dataclass(frozen=True, slots=True, eq=False)
class Polylines:
    """C polylines.

    points: (P, 2), of polyline k from first[k] to first[k + 1]. arc_px: (P,) the distance of each along its
    polyline, which begins where the one before ends, and one pixel.
    """

    points: Floats
    first: Indices
    arc_px: Floats

    @classmethod
    def of(cls, polylines: Sequence[RealArray]) -> Polylines:
        """Join polylines (K, 2)."""
        first = np.concatenate([[0], np.cumsum([len(polyline) for polyline in polylines])])
        points = np.concatenate(polylines, dtype=np.float64)
        steps = points[1:] - points[:-1]
        steps_px = np.hypot(steps[:, 0], steps[:, 1])
        steps_px[first[1:-1] - 1] = 1  # from the end of one to the next
        return cls(points, first, np.concatenate([[0], np.cumsum(steps_px)]))

    @property
    def lengths_px(self) -> Floats:
        """(C,) lengths."""
        return self.arc_px[self.first[1:] - 1] - self.arc_px[self.first[:-1]]

    def at(self, number: Indices, distance_px: Floats) -> Floats:
        """(..., 2) places on the polylines `number` at a distance from their start."""
        arc_px = self.arc_px[self.first[number]] + distance_px
        return np.stack([np.interp(arc_px, self.arc_px, self.points[:, k]) for k in (0, 1)], axis=-1)

    def spaced(self, count: int) -> Floats:
        """(C, count, 2) evenly spaced places on each polyline, ends included."""
        shares = np.linspace(0, 1, count)
        return self.at(np.arange(len(self.first) - 1)[:, None], self.lengths_px[:, None] * shares)
