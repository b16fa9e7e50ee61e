"""All polylines of an image in one array."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

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
        counts = np.array([len(polyline) for polyline in polylines], np.intp)
        return cls.joined(np.concatenate([np.zeros((0, 2)), *polylines]), counts)

    @classmethod
    def joined(cls, points: RealArray, counts: Indices) -> Polylines:
        """Divide points (P, 2) into polylines of `counts` (C,) points."""
        points_px: Floats = points.astype(np.float64)
        first = np.concatenate([[0], np.cumsum(counts)])
        steps = points_px[1:] - points_px[:-1]
        steps_px = np.hypot(steps[:, 0], steps[:, 1])
        steps_px[first[1:-1] - 1] = 1  # from the end of one to the next
        return cls(points_px, first, np.concatenate([[0], np.cumsum(steps_px)]))

    def __len__(self) -> int:
        return len(self.first) - 1

    def __getitem__(self, k: int) -> Floats:
        return self.points[self.first[k] : self.first[k + 1]]

    def __iter__(self) -> Iterator[Floats]:
        return (self[k] for k in range(len(self)))

    @property
    def lengths_px(self) -> Floats:
        """(C,) lengths."""
        return self.arc_px[self.first[1:] - 1] - self.arc_px[self.first[:-1]]

    def at(self, number: Indices, distance_px: Floats) -> Floats:
        """(..., 2) places on the polylines `number` at a distance from their start."""
        arc_px = self.arc_px[self.first[number]] + distance_px
        found = np.empty((*arc_px.shape, 2))
        for k in (0, 1):
            found[..., k] = np.interp(arc_px, self.arc_px, self.points[:, k])
        return found

    def spaced(self, count: int, number: Indices) -> Floats:
        """(C, count, 2) evenly spaced places on the polylines `number` (C,), ends included."""
        shares = np.linspace(0, 1, count)
        return self.at(number[:, None], self.lengths_px[number, None] * shares)
