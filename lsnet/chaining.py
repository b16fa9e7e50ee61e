"""Chain the overlapping segments of the four grids into polylines.

Two segments are linked when they have nearly the same direction, lie on each other's line, and touch or
nearly touch. Linked segments form a chain; its polyline is the score-weighted mean of the segments along it.
The odds of a line are the odds of its segments times its length: each cell along it is further evidence.

All chains of an image are processed at once, in arrays with the number of the chain beside each value.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from lsnet.bridging import group_stretches
from lsnet.geometry import angle_between, length, orientation
from lsnet.segments import Detections, Lines, Segments

if TYPE_CHECKING:
    from lsnet.arrays import Floats, Floats32, Indices

MIN_OFFSET_PX = 0.7  # a smaller link tolerance would cut lines at random
TIGHTENING = 0.6  # factor of the link tolerance when a chain is split
REFERENCE_LENGTHS_PX = (240.0, 1000.0)  # bounds of the reference length, whatever the image
MIN_DOUBT = 0.02  # keeps the odds of segments finite


@dataclass(frozen=True, slots=True)
class ChainingConfig:
    """What counts as one line. Lengths are in pixels of the network's input image."""

    min_segment_score: float = 0.3  # weaker segments are not linked, whatever the user's threshold
    max_angle_deg: float = 12.0  # between linked segments
    max_offset_px: float = 2.0  # of each segment's midpoint from the other's line
    max_gap_px: float = 20.0  # along the line, between linked segments
    max_bridge_px: float = 60.0  # along the line, between chains that continue each other
    max_spread_px: float = 1.5  # of a chain's segments about its polyline; a wider chain is split
    min_length_px: float = 40.0  # shorter chains are dropped
    reference_length: float = 1.35  # in shorter sides of the image: where a line's odds are its segments'
    full_support: float = 2.0  # cells per stretch (of at most four) for all of a line's length to count
    step_px: float = 16.0  # between points of a polyline, before simplification
    flatness_px: float = 0.4  # largest deviation by simplification


class _Line(NamedTuple):
    points: Floats32  # (K, 2)
    score: float
    members: Indices  # its segments


def chain_segments(segments: Segments, config: ChainingConfig, enlargement: float = 1.0) -> Detections:
    """Merge the segments of one image into lines.

    A large view has more places for false lines, so the length that a line needs grows with the image;
    `enlargement`, the factor by which the image was enlarged before detection, does not count.

    Returns:
        The given segments, the lines with the highest score first, and the line of each segment.
    """
    strong = np.flatnonzero(segments.scores >= config.min_segment_score)
    reference_px = config.reference_length * min(segments.image_size) / enlargement
    reference_px = float(np.clip(reference_px, *REFERENCE_LENGTHS_PX))
    found = _find_lines(segments.endpoints[strong], segments.scores[strong], reference_px, config)
    found.sort(key=lambda line: -line.score)
    line_of = np.full(len(segments), -1, np.int32)
    for k, line in enumerate(found):
        line_of[strong[line.members]] = k
    scores = np.array([line.score for line in found], np.float32)
    lines = Lines(tuple(line.points for line in found), scores, segments.image_size)
    return Detections(segments, lines, line_of)


def _find_lines(
    endpoints: Floats32, scores: Floats32, reference_px: float, config: ChainingConfig
) -> list[_Line]:
    """Lines of segments (N, 4) with scores (N,).

    Cables a few pixels apart can end up in one chain. Its segments then lie on both sides of its
    polyline, and they are linked again with a smaller tolerance.
    """
    parts: list[Indices] = []
    polylines: list[Floats] = []
    ends, pairs, offsets = endpoints.astype(float), np.zeros((0, 2), np.intp), np.zeros(0)
    if len(ends):
        pairs, offsets = _link(ends, config)
    left, tolerance_px = np.arange(len(ends)), config.max_offset_px
    while len(left):
        chains = _Chains.connected(ends, pairs[offsets <= tolerance_px], left, config.min_length_px)
        if not len(chains.members):
            break
        fit = _fit(ends[chains.members], scores[chains.members].astype(float), chains, config)
        is_wide = (fit.spread_px > config.max_spread_px) & (tolerance_px > MIN_OFFSET_PX)
        for k in np.flatnonzero(~is_wide & (fit.extent_px >= config.min_length_px)):
            parts.append(chains.members_of(int(k)))
            polylines.append(fit.polyline(int(k)))
        left = chains.members[is_wide[chains.number]]
        is_left = np.isin(pairs, left).all(axis=1)
        pairs, offsets = pairs[is_left], offsets[is_left]
        tolerance_px *= TIGHTENING
    if not parts:
        return []
    chains = _Chains.joined(parts, group_stretches(polylines, config.max_bridge_px))
    fit = _fit(ends[chains.members], scores[chains.members].astype(float), chains, config)
    line_scores = fit.line_scores(reference_px, config)
    return [
        _Line(_simplified(fit.polyline(k), config), float(line_scores[k]), chains.members_of(k))
        for k in range(len(line_scores))
    ]


def _simplified(polyline: Floats, config: ChainingConfig) -> Floats32:
    points = polyline.astype(np.float32)[:, None]
    return np.asarray(cv2.approxPolyDP(points, config.flatness_px, closed=False)[:, 0], np.float32)


def _link(ends: Floats, config: ChainingConfig) -> tuple[Indices, Floats]:
    """Find the pairs of segments (N, 4) that may be linked.

    Returns:
        (P, 2) pairs of segments, and (P,) the larger distance of one's midpoint from the other's line, px.
    """
    middles, lengths = (ends[:, :2] + ends[:, 2:]) / 2, np.maximum(length(ends), 1e-9)
    pairs = cKDTree(middles).query_pairs(lengths.max() + config.max_gap_px, output_type="ndarray")
    angles = orientation(ends)
    is_parallel = angle_between(angles[pairs[:, 0]], angles[pairs[:, 1]]) <= np.radians(config.max_angle_deg)
    pairs = pairs[is_parallel]
    i, j = pairs[:, 0], pairs[:, 1]
    directions = (ends[:, 2:] - ends[:, :2]) / lengths[:, None]
    between = middles[j] - middles[i]
    offsets = np.maximum(np.abs(_cross(directions[i], between)), np.abs(_cross(directions[j], between)))
    gaps = np.abs((directions[i] * between).sum(1)) - (lengths[i] + lengths[j]) / 2
    is_linked = (offsets <= config.max_offset_px) & (gaps <= config.max_gap_px)
    return pairs[is_linked], offsets[is_linked]


def _cross(a: Floats, b: Floats) -> Floats:
    out: Floats = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return out


@dataclass(frozen=True, slots=True, eq=False)
class _Chains:
    """C chains of M segments.

    members: (M,) segments, ordered by chain. number: (M,) the chain of each. first: (C + 1,) where each
    chain starts in `members`.
    """

    members: Indices
    number: Indices
    first: Indices

    @classmethod
    def connected(cls, ends: Floats, pairs: Indices, left: Indices, min_length_px: float) -> _Chains:
        """Chain the segments `left` that `pairs` connect; drop chains whose bounding box is too small."""
        ones = np.ones(len(pairs), np.int8)
        graph = coo_array((ones, (pairs[:, 0], pairs[:, 1])), shape=(len(ends), len(ends)))
        chain_of = connected_components(graph, directed=False)[1][left]
        order = np.argsort(chain_of, kind="stable")
        chain_of, members = chain_of[order], left[order]
        starts = np.flatnonzero(np.diff(chain_of, prepend=-1))
        counts = np.diff(starts, append=len(members))
        start, end = ends[members, :2], ends[members, 2:]
        low = np.minimum.reduceat(np.minimum(start, end), starts)
        high = np.maximum.reduceat(np.maximum(start, end), starts)
        is_long = np.hypot(*(high - low).T) >= min_length_px
        members, counts = members[np.repeat(is_long, counts)], counts[is_long]
        return cls(
            members, np.repeat(np.arange(len(counts)), counts), np.concatenate([[0], np.cumsum(counts)])
        )

    @classmethod
    def joined(cls, parts: list[Indices], labels: Indices) -> _Chains:
        """Join the parts that have the same label."""
        number = np.repeat(labels, [len(part) for part in parts])
        order = np.argsort(number, kind="stable")
        counts = np.bincount(number)
        return cls(np.concatenate(parts)[order], number[order], np.concatenate([[0], np.cumsum(counts)]))

    def members_of(self, k: int) -> Indices:
        """Segments of chain k."""
        return self.members[self.first[k] : self.first[k + 1]]

    def sum(self, values: Floats) -> Floats:
        """(C,) sums over each chain of a value per segment (M,)."""
        out: Floats = np.bincount(self.number, values, len(self.first) - 1).astype(float)
        return out


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """Polylines fitted to C chains.

    points: (P, 2), of chain k from first[k] to first[k + 1]. Per chain, (C,): extent_px, its length;
    spread_px, of its segments about the polyline; mean_score of its segments; support, the number of
    segments over each stretch.
    """

    points: Floats
    first: Indices
    extent_px: Floats
    spread_px: Floats
    mean_score: Floats
    support: Floats

    def polyline(self, k: int) -> Floats:
        """(K, 2) points of chain k."""
        return self.points[self.first[k] : self.first[k + 1]]

    def line_scores(self, reference_px: float, config: ChainingConfig) -> Floats:
        """(C,) score of each line: odds of its segments times its supported length over the reference."""
        mean_score = np.clip(self.mean_score, MIN_DOUBT, 1 - MIN_DOUBT)
        supported_px = self.extent_px * np.minimum(self.support / config.full_support, 1)
        odds = mean_score / (1 - mean_score) * supported_px / reference_px
        out: Floats = odds / (1 + odds)
        return out


def _fit(ends: Floats, scores: Floats, chains: _Chains, config: ChainingConfig) -> _Fit:
    """Fit polylines to chains of segments (M, 4) with scores (M,), in the order of the chains."""
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

    count = np.maximum(np.round(extent / config.step_px).astype(np.intp) + 1, 2)
    step, first = extent / (count - 1), np.concatenate([[0], np.cumsum(count)])
    offsets = _mean_offsets(
        u, v, scores, step=step[of], count=count[of], first=first[of], reach_px=config.step_px
    )
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
    return _Fit(points, first, extent, spread, mean_score, total_length / np.maximum(extent, 1e-9))


def _main_axes(ends: Floats, scores: Floats, chains: _Chains) -> tuple[Floats, Floats]:
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
