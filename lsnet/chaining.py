"""From cells to lines: the overlapping segments of the four grids chained into polylines.

Two segments belong together when they run alike, lie on each other's line and touch or nearly touch. Linked
segments form a chain; its polyline is the score-weighted mean of the segments along it. Its odds of being a
line are those of its segments times its length: every cell along it is one more witness.

All chains of an image are worked on at once: a quantity per segment or per point of a polyline is one array,
with the number of its chain beside it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from lsnet.bridging import bridged
from lsnet.geometry import angle_between, length, orientation
from lsnet.segments import Lines, Segments

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Float = NDArray[np.float64]
    Int = NDArray[np.intp]
    Found = tuple[NDArray[np.float32], float, Int]  # points, score, segments

MIN_OFFSET_PX = 0.7  # linking with less tolerance than this would cut lines at random
TIGHTER = 0.6  # of the tolerance, when a chain is taken apart
EVEN_LENGTHS_PX = (240.0, 1000.0)  # bounds of the length that leaves the odds as they are, whatever the image
LEAST_DOUBT = 0.02  # of the segments of a line, so that none is beyond it


@dataclass(frozen=True, slots=True)
class MergeConfig:
    """What counts as one line. Lengths are in pixels of the network's image."""

    min_segment_score: float = 0.3  # a weaker segment takes no part, whatever is asked for
    max_angle_deg: float = 12.0  # between linked segments
    max_offset_px: float = 2.0  # of each one's middle from the other's line
    max_gap_px: float = 20.0  # along the line, between linked segments
    max_bridge_px: float = 60.0  # along the line, between chains that go on in each other's direction
    max_spread_px: float = 1.5  # of a chain's segments about its polyline; a wider chain is taken apart
    min_length_px: float = 40.0  # a shorter chain is no line
    even_length: float = 1.35  # of the image's shorter side, at which a line is as sure as its segments
    witnesses: float = 2.0  # cells that tell each stretch of a line, of four, for all of its length to count
    step_px: float = 16.0  # between the points of a polyline, before it is simplified
    flatness_px: float = 0.4  # how far simplifying may move it


def merge_with_owners(
    segments: Segments, config: MergeConfig, enlarged: float = 1.0
) -> tuple[Lines, NDArray[np.int32]]:
    """Lines of one image, strongest first, and (N,) the line each segment belongs to, -1 for none.

    enlarged: how many times the network's image is larger than what was photographed. The more there is to
    see, the more chances has a false line, so a line must be longer; what is enlarged shows no more.
    """
    sure = np.flatnonzero(segments.scores >= config.min_segment_score)
    even_px = float(np.clip(config.even_length * min(segments.image_size) / enlarged, *EVEN_LENGTHS_PX))
    found = _lines_of(segments.endpoints[sure], segments.scores[sure], even_px, config)
    found.sort(key=lambda line: -line[1])
    owners = np.full(len(segments), -1, np.int32)
    for k, (_, _, members) in enumerate(found):
        owners[sure[members]] = k
    scores = np.array([score for _, score, _ in found], np.float32)
    return Lines(tuple(points for points, _, _ in found), scores, segments.image_size), owners


def _lines_of(
    endpoints: NDArray[np.float32],
    scores: NDArray[np.float32],
    even_px: float,
    config: MergeConfig,
) -> list[Found]:
    """Points, score and members of each line; `even_px` is the length that leaves the odds as they are.

    Cables a few pixels apart can end up in one chain; its segments then lie to both sides of its
    polyline, and they are linked again with less tolerance.
    """
    parts: list[Int] = []
    polylines: list[Float] = []
    ends, pairs, offsets = endpoints.astype(float), np.zeros((0, 2), np.intp), np.zeros(0)
    if len(ends):
        pairs, offsets = link(ends, config)
    left, tolerance_px = np.arange(len(ends)), config.max_offset_px
    while len(left):
        chains = _Chains.of(ends, pairs[offsets <= tolerance_px], left, config.min_length_px)
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
        tolerance_px *= TIGHTER
    if not parts:
        return []
    chains = _Chains.joined(parts, bridged(polylines, config.max_bridge_px))
    fit = _fit(ends[chains.members], scores[chains.members].astype(float), chains, config)
    line_scores = fit.scores(even_px, config)
    return [
        (_simplified(fit.polyline(k), config), float(line_scores[k]), chains.members_of(k))
        for k in range(len(line_scores))
    ]


def _simplified(polyline: Float, config: MergeConfig) -> NDArray[np.float32]:
    points = polyline.astype(np.float32)[:, None]
    return np.asarray(cv2.approxPolyDP(points, config.flatness_px, closed=False)[:, 0], np.float32)


def link(ends: Float, config: MergeConfig) -> tuple[Int, Float]:
    """(P, 2) segments of (N, 4) that may be linked, and (P,) how far they are off each other's line, px."""
    middles, lengths = (ends[:, :2] + ends[:, 2:]) / 2, np.maximum(length(ends), 1e-9)
    pairs = cKDTree(middles).query_pairs(lengths.max() + config.max_gap_px, output_type="ndarray")
    angles = orientation(ends)
    is_alike = angle_between(angles[pairs[:, 0]], angles[pairs[:, 1]]) <= np.radians(config.max_angle_deg)
    pairs = pairs[is_alike]
    i, j = pairs[:, 0], pairs[:, 1]
    directions = (ends[:, 2:] - ends[:, :2]) / lengths[:, None]
    between = middles[j] - middles[i]
    offsets = np.maximum(np.abs(_cross(directions[i], between)), np.abs(_cross(directions[j], between)))
    gaps = np.abs((directions[i] * between).sum(1)) - (lengths[i] + lengths[j]) / 2
    is_linked = (offsets <= config.max_offset_px) & (gaps <= config.max_gap_px)
    return pairs[is_linked], offsets[is_linked]


def _cross(a: Float, b: Float) -> Float:
    out: Float = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return out


@dataclass(frozen=True, slots=True, eq=False)
class _Chains:
    """Segments in order of their chain: members (M,), the chain of each (M,), where each begins (C + 1,)."""

    members: Int
    number: Int
    first: Int

    @classmethod
    def of(cls, ends: Float, pairs: Int, left: Int, min_length_px: float) -> _Chains:
        """The chains among the segments `left`, without those whose box no line of that length fits in."""
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
    def joined(cls, parts: list[Int], labels: Int) -> _Chains:
        """Chains of the segments of all parts that have the same label."""
        number = np.repeat(labels, [len(part) for part in parts])
        order = np.argsort(number, kind="stable")
        counts = np.bincount(number)
        return cls(np.concatenate(parts)[order], number[order], np.concatenate([[0], np.cumsum(counts)]))

    def members_of(self, k: int) -> Int:
        """The segments of chain k."""
        return self.members[self.first[k] : self.first[k + 1]]

    def sum(self, values: Float) -> Float:
        """(C,) sum over each chain of a value per segment (M,)."""
        out: Float = np.bincount(self.number, values, len(self.first) - 1).astype(float)
        return out


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """Polylines of C chains: points (P, 2), of chain k from first[k] to first[k + 1], and per chain (C,)
    its extent, the spread of its segments about it, the mean of their scores, and how many cells tell a
    stretch.
    """

    points: Float
    first: Int
    extent_px: Float
    spread_px: Float
    mean_score: Float
    support: Float

    def polyline(self, k: int) -> Float:
        """(K, 2) points of chain k."""
        return self.points[self.first[k] : self.first[k + 1]]

    def scores(self, even_px: float, config: MergeConfig) -> Float:
        """(C,) score of each line, from its odds."""
        sure = np.clip(self.mean_score, LEAST_DOUBT, 1 - LEAST_DOUBT)
        told_px = self.extent_px * np.minimum(self.support / config.witnesses, 1)
        odds = sure / (1 - sure) * told_px / even_px
        out: Float = odds / (1 + odds)
        return out


def _fit(ends: Float, scores: Float, chains: _Chains, config: MergeConfig) -> _Fit:
    """Polylines of chains from their segments (M, 4) and scores (M,), in the order of the chains."""
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

    place = u.mean(axis=1) / step[of]  # of each segment's middle, in points of its polyline
    before = np.minimum(place.astype(np.intp), count[of] - 2)
    share, here = place - before, first[of] + before
    distance = offsets[here] * (1 - share) + offsets[here + 1] * share - v.mean(axis=1)
    spread = np.sqrt(chains.sum(scores * distance**2) / chains.sum(scores))
    lengths = length(ends).astype(float)
    told = chains.sum(lengths)
    mean_score = chains.sum(scores * lengths) / np.maximum(told, 1e-9)
    return _Fit(points, first, extent, spread, mean_score, told / np.maximum(extent, 1e-9))


def _main_axes(ends: Float, scores: Float, chains: _Chains) -> tuple[Float, Float]:
    """(C, 2) centre and unit direction of greatest spread of the endpoints of each chain."""
    middles, weights = (ends[:, :2] + ends[:, 2:]) / 2, chains.sum(scores)
    origin = np.stack([chains.sum(scores * middles[:, k]) / weights for k in (0, 1)], axis=1)
    x, y = np.moveaxis(ends.reshape(-1, 2, 2) - origin[chains.number, None], -1, 0)
    xx, yy, xy = (chains.sum(scores * (a * b).sum(1)) for a, b in ((x, x), (y, y), (x, y)))
    angle = np.arctan2(2 * xy, xx - yy) / 2
    return origin, np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _mean_offsets(
    u: Float, v: Float, scores: Float, *, step: Float, count: Int, first: Int, reach_px: float
) -> Float:
    """(P,) offset of the polylines at their points: the weighted mean of the segments that pass near.

    Each segment speaks for where it lies, and fades out within `reach_px` beyond its ends; u, v are (M, 2),
    along and across the line; step, count and first (M,) of the points of its polyline. Where none is near,
    points lie between their neighbours.
    """
    slope = (v[:, 1] - v[:, 0]) / np.maximum(u[:, 1] - u[:, 0], 1e-6)
    low = np.maximum(np.ceil((u[:, 0] - reach_px) / step), 0).astype(np.intp)
    high = np.minimum(np.floor((u[:, 1] + reach_px) / step).astype(np.intp), count - 1)
    reached = np.maximum(high - low + 1, 0)
    which = np.repeat(np.arange(len(u)), reached)  # (Q,) segment of each pair of a segment and a point
    number = low[which] + np.arange(len(which)) - np.repeat(np.cumsum(reached) - reached, reached)
    at, point = number * step[which], first[which] + number
    # A position outside a segment takes the height of its nearer end, so steep ones do not fly off.
    inside = np.clip(at, u[which, 0], u[which, 1])
    weights = scores[which] * np.exp(-(((at - inside) / (reach_px / 4)) ** 2))
    heights = v[which, 0] + slope[which] * (inside - u[which, 0])
    total = np.bincount(point, weights)
    told = np.flatnonzero(total > 0)  # the ends of each polyline always are
    means = np.bincount(point, weights * heights)[told] / total[told]
    out: Float = np.interp(np.arange(len(total)), told, means)
    return out
