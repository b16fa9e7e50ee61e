"""Chains of linked segments, and the polylines fitted to them: all of an image at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from lsnet.geometry import length
from lsnet.lines.components import components
from lsnet.lines.polylines import Polylines

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lsnet.arrays import Floats, Indices, Mask


@dataclass(frozen=True, slots=True, eq=False)
class Chains:
    """C chains of M segments.

    members: (M,) segments, ordered by chain. number: (M,) the chain of each. first: (C + 1,) where each
    chain starts in `members`.
    """

    members: Indices
    number: Indices
    first: Indices

    @classmethod
    def connected(cls, ends: Floats, pairs: Indices, left: Indices, min_length_px: float) -> Chains:
        """Chain the segments `left` that `pairs` connect; drop chains whose bounding box is too small."""
        chain_of = components(len(ends), pairs)[left]
        order = np.argsort(chain_of, kind="stable")
        chain_of, members = chain_of[order], left[order]
        starts = np.flatnonzero(np.diff(chain_of, prepend=-1))
        counts = np.diff(starts, append=len(members))
        start, end = ends[members, :2], ends[members, 2:]
        low = np.minimum.reduceat(np.minimum(start, end), starts)
        high = np.maximum.reduceat(np.maximum(start, end), starts)
        is_long = np.hypot(*(high - low).T) >= min_length_px
        return cls.of(members[np.repeat(is_long, counts)], counts[is_long])

    @classmethod
    def of(cls, members: Indices, counts: Indices) -> Chains:
        """Divide members (M,) into chains of `counts` (C,)."""
        number = np.repeat(np.arange(len(counts)), counts)
        return cls(members, number, np.concatenate([[0], np.cumsum(counts)]))

    def chosen(self, which: Mask) -> Chains:
        """Return some of the chains, (C,) which."""
        return Chains.of(self.members[which[self.number]], np.diff(self.first)[which])

    @classmethod
    def together(cls, parts: Sequence[Chains]) -> Chains:
        """Return the chains of all parts."""
        members, counts = zip(*((part.members, np.diff(part.first)) for part in parts), strict=True)
        return cls.of(np.concatenate(members), np.concatenate(counts))

    def joined(self, labels: Indices) -> Chains:
        """Return the chains that come of joining those with the same label, (C,)."""
        number = labels[self.number]
        return Chains.of(self.members[np.argsort(number, kind="stable")], np.bincount(number))

    def sum(self, values: Floats) -> Floats:
        """(C,) sums over each chain of a value per segment (M,)."""
        out: Floats = np.bincount(self.number, values, len(self.first) - 1).astype(float)
        return out


@dataclass(frozen=True, slots=True, eq=False)
class ChainFits:
    """Polylines fitted to C chains.

    Per chain, (C,): extent_px, its length; spread_px, of its segments about the polyline; mean_score of its
    segments; support, the number of segments over each stretch.
    """

    polylines: Polylines
    extent_px: Floats
    spread_px: Floats
    mean_score: Floats
    support: Floats

    def chosen(self, which: Mask) -> ChainFits:
        """Return the fits of some of the chains, (C,) which."""
        counts = np.diff(self.polylines.first)
        points = self.polylines.points[np.repeat(which, counts)]
        return ChainFits(Polylines.joined(points, counts[which]), *(v[which] for v in self._values()))

    @classmethod
    def together(cls, parts: Sequence[ChainFits]) -> ChainFits:
        """Return the fits of all parts."""
        points, counts = (
            np.concatenate(values)
            for values in zip(*((p.polylines.points, np.diff(p.polylines.first)) for p in parts), strict=True)
        )
        values = zip(*(part._values() for part in parts), strict=True)
        return cls(Polylines.joined(points, counts), *map(np.concatenate, values))

    def _values(self) -> tuple[Floats, Floats, Floats, Floats]:
        return self.extent_px, self.spread_px, self.mean_score, self.support


def fit_chains(ends: Floats, scores: Floats, chains: Chains, step_px: float) -> ChainFits:
    """Fit polylines to chains of segments (N, 4) with scores (N,)."""
    ends, scores = ends[chains.members], scores[chains.members]
    if not len(ends):
        none = np.zeros(0)
        return ChainFits(Polylines.joined(np.zeros((0, 2)), chains.number), none, none, none, none)
    origin, axis = _main_axes(ends, scores, chains)
    across = np.stack([-axis[:, 1], axis[:, 0]], axis=1)
    of = chains.number
    relative = ends.reshape(-1, 2, 2) - origin[of, None]
    u, v = (relative * axis[of, None]).sum(-1), (relative * across[of, None]).sum(-1)  # (M, 2) each
    order = np.argsort(u, axis=1)
    u, v = np.take_along_axis(u, order, 1), np.take_along_axis(v, order, 1)
    begin = np.minimum.reduceat(u[:, 0], chains.first[:-1])
    extent = np.maximum.reduceat(u[:, 1], chains.first[:-1]) - begin
    u -= begin[of, None]

    count = np.maximum(np.round(extent / step_px).astype(np.intp) + 1, 2)
    step, first = extent / (count - 1), np.concatenate([[0], np.cumsum(count)])
    offsets = _mean_offsets(u, v, scores, step=step[of], count=count[of], first=first[of], reach_px=step_px)
    point_of = np.repeat(np.arange(len(count)), count)
    at = begin[point_of] + (np.arange(first[-1]) - first[point_of]) * step[point_of]
    points = origin[point_of] + at[:, None] * axis[point_of] + offsets[:, None] * across[point_of]

    place = u.mean(axis=1) / step[of]  # of each segment's midpoint, in points of its polyline
    before = np.minimum(place.astype(np.intp), count[of] - 2)
    share, here = place - before, first[of] + before
    distance = offsets[here] * (1 - share) + offsets[here + 1] * share - v.mean(axis=1)
    spread = np.sqrt(chains.sum(scores * distance**2) / chains.sum(scores))
    lengths = length(ends).astype(float)
    total_length = chains.sum(lengths)
    mean_score = chains.sum(scores * lengths) / np.maximum(total_length, 1e-9)
    return ChainFits(
        Polylines.joined(points, count), extent, spread, mean_score, total_length / np.maximum(extent, 1e-9)
    )


def _main_axes(ends: Floats, scores: Floats, chains: Chains) -> tuple[Floats, Floats]:
    """(C, 2) centre, and (C, 2) unit direction of the greatest spread of the endpoints, of each chain."""
    middles, weights = (ends[:, :2] + ends[:, 2:]) / 2, chains.sum(scores)
    origin = np.stack([chains.sum(scores * middles[:, k]) / weights for k in (0, 1)], axis=1)
    x, y = np.moveaxis(ends.reshape(-1, 2, 2) - origin[chains.number, None], -1, 0)
    xx, yy, xy = (chains.sum(scores * (a * b).sum(1)) for a, b in ((x, x), (y, y), (x, y)))
    angle = np.arctan2(2 * xy, xx - yy) / 2
    return origin, np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _mean_offsets(
    u: Floats, v: Floats, scores: Floats, *, step: Floats, count: Indices, first: Indices, reach_px: float
) -> Floats:
    """(P,) offsets of the polylines at their points: the weighted mean of the segments near each point.

    A segment has full weight along its length, and fades out within `reach_px` beyond its ends. Points
    without a segment nearby are interpolated.

    Args:
        u: (M, 2) endpoints along the line.
        v: (M, 2) endpoints across it.
        scores: (M,) of the segments.
        step: (M,) between the points of each segment's polyline.
        count: (M,) of these points.
        first: (M,) index of the first one.
        reach_px: see above.
    """
    slope = (v[:, 1] - v[:, 0]) / np.maximum(u[:, 1] - u[:, 0], 1e-6)
    low = np.maximum(np.ceil((u[:, 0] - reach_px) / step), 0).astype(np.intp)
    high = np.minimum(np.floor((u[:, 1] + reach_px) / step).astype(np.intp), count - 1)
    reached = np.maximum(high - low + 1, 0)
    which = np.repeat(np.arange(len(u)), reached)  # (Q,) segment of each pair of a segment and a point
    number = low[which] + np.arange(len(which)) - np.repeat(np.cumsum(reached) - reached, reached)
    at, point = number * step[which], first[which] + number
    # Beyond its ends a segment counts with the height of the nearer end: steep ones are not extrapolated.
    inside = np.clip(at, u[which, 0], u[which, 1])
    weights = scores[which] * np.exp(-(((at - inside) / (reach_px / 4)) ** 2))
    heights = v[which, 0] + slope[which] * (inside - u[which, 0])
    total = np.bincount(point, weights)
    known = np.flatnonzero(total > 0)  # includes both ends of each polyline
    means = np.bincount(point, weights * heights)[known] / total[known]
    out: Floats = np.interp(np.arange(len(total)), known, means)
    return out
