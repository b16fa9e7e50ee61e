"""From cells to lines: the overlapping segments of the four grids chained into polylines.

Two segments belong together when they run alike, lie on each other's line and touch or nearly touch. Linked
segments form a chain; its polyline is the score-weighted mean of the segments along it, its score says how
sure they are and how long it is.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from lsnet.geometry import angle_between, length, orientation
from lsnet.segments import Lines, Segments

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Float = NDArray[np.float64]


MIN_OFFSET_PX = 0.7  # linking with less tolerance than this would cut lines at random


@dataclass(frozen=True, slots=True)
class MergeConfig:
    """What counts as one line. Lengths are in pixels of the network's image."""

    min_segment_score: float = 0.3  # a weaker segment takes no part, whatever is asked for
    max_angle_deg: float = 12.0  # between linked segments
    max_offset_px: float = 2.0  # of each one's middle from the other's line
    max_gap_px: float = 20.0  # along the line, between linked segments
    max_spread_px: float = 1.5  # of a chain's segments about its polyline; a wider chain is taken apart
    min_length_px: float = 40.0  # a shorter chain is no line
    sure_length_px: float = 90.0  # at which a line's length has earned 63 % of what it can
    step_px: float = 16.0  # between the points of a polyline, before it is simplified
    flatness_px: float = 0.4  # how far simplifying may move it


def merge(segments: Segments, config: MergeConfig | None = None) -> Lines:
    """Lines of one image, strongest first."""
    config = config or MergeConfig()
    sure = segments.above(config.min_segment_score)
    found = _lines_of(sure, np.arange(len(sure)), config, config.max_offset_px)
    found.sort(key=lambda line: -line[1])
    scores = np.array([score for _, score in found], np.float32)
    return Lines(tuple(points for points, _ in found), scores, segments.image_size)


def _lines_of(
    segments: Segments, members: NDArray[np.intp], config: MergeConfig, offset_px: float
) -> list[tuple[NDArray[np.float32], float]]:
    """Polylines and scores of the chains among `members`.

    Cables a few pixels apart can end up in one chain; its segments then lie to both sides of its
    polyline, and it is linked again with less tolerance.
    """
    if not len(members):
        return []
    found = []
    ends = segments.endpoints[members].astype(float)
    chain_of = link(ends, config, offset_px)
    for k in np.flatnonzero(_diagonals(ends, chain_of) >= config.min_length_px):
        chain = members[chain_of == k]
        line, spread_px = _to_line(segments, chain, config)
        if spread_px > config.max_spread_px and offset_px > MIN_OFFSET_PX:
            found += _lines_of(segments, chain, config, offset_px * 0.6)
        elif line is not None:
            found.append(line)
    return found


def link(ends: Float, config: MergeConfig, offset_px: float) -> NDArray[np.int32]:
    """(N,) number of the chain of each of the segments (N, 4), from 0."""
    middles, reach = (ends[:, :2] + ends[:, 2:]) / 2, length(ends).max() + config.max_gap_px
    pairs = cKDTree(middles).query_pairs(reach, output_type="ndarray")
    pairs = pairs[_belong_together(ends, pairs, config, offset_px)]
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(ends), len(ends)))
    _, chain_of = connected_components(graph, directed=False)
    return np.asarray(chain_of, np.int32)


def _belong_together(
    ends: Float, pairs: NDArray[np.intp], config: MergeConfig, offset_px: float
) -> NDArray[np.bool_]:
    """(P,) whether the segments of each pair (P, 2) are linked."""
    i, j = pairs[:, 0], pairs[:, 1]
    middles, angles, lengths = (
        (ends[:, :2] + ends[:, 2:]) / 2,
        orientation(ends),
        np.maximum(length(ends), 1e-9),
    )
    directions = (ends[:, 2:] - ends[:, :2]) / lengths[:, None]
    between = middles[j] - middles[i]
    offset = np.maximum(np.abs(_cross(directions[i], between)), np.abs(_cross(directions[j], between)))
    along = np.abs((directions[i] * between).sum(1))
    gap = along - (lengths[i] + lengths[j]) / 2
    limit = np.radians(config.max_angle_deg)
    is_alike = angle_between(angles[i], angles[j]) <= limit
    return np.asarray(is_alike & (offset <= offset_px) & (gap <= config.max_gap_px))


def _cross(a: Float, b: Float) -> Float:
    out: Float = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return out


def _diagonals(ends: Float, chain_of: NDArray[np.int32]) -> Float:
    """(chains,) diagonal of the box around each chain: no line of it is longer."""
    count = int(chain_of.max()) + 1
    low, high = np.full((count, 2), np.inf), np.full((count, 2), -np.inf)
    for points in (ends[:, :2], ends[:, 2:]):
        np.minimum.at(low, chain_of, points)
        np.maximum.at(high, chain_of, points)
    diagonals: Float = np.hypot(*(high - low).T)
    return diagonals


def _to_line(
    segments: Segments, chain: NDArray[np.intp], config: MergeConfig
) -> tuple[tuple[NDArray[np.float32], float] | None, float]:
    """The polyline of a chain with its score, None when it is too short; and the spread about it, px."""
    ends, scores = segments.endpoints[chain].astype(float), segments.scores[chain].astype(float)
    origin, axis = _main_axis(ends, scores)
    across = np.array([-axis[1], axis[0]])
    points = ends.reshape(-1, 2, 2) - origin
    u, v = points @ axis, points @ across
    order = np.argsort(u, axis=1)
    u, v = np.take_along_axis(u, order, 1), np.take_along_axis(v, order, 1)
    extent = u.max() - u.min()
    at = np.linspace(u.min(), u.max(), max(2, round(extent / config.step_px) + 1))
    offsets = _mean_offsets(at, u, v, scores, config.step_px)
    middles = np.interp(u.mean(axis=1), at, offsets) - v.mean(axis=1)
    spread = float(np.sqrt(np.average(middles**2, weights=scores)))
    if extent < config.min_length_px:
        return None, spread
    polyline = (origin + at[:, None] * axis + offsets[:, None] * across).astype(np.float32)
    simple = cv2.approxPolyDP(polyline[:, None], config.flatness_px, closed=False)[:, 0]
    score = np.average(scores, weights=length(ends)) * (1 - np.exp(-extent / config.sure_length_px))
    return (np.asarray(simple, np.float32), float(score)), spread


def _main_axis(ends: Float, scores: Float) -> tuple[Float, Float]:
    """Centre and unit direction of greatest spread of all endpoints."""
    points, weights = ends.reshape(-1, 2), np.repeat(scores, 2)
    origin = np.average(points, axis=0, weights=weights)
    spread = np.cov((points - origin).T, aweights=weights, ddof=0)
    return origin, np.linalg.eigh(spread)[1][:, -1]


def _mean_offsets(at: Float, u: Float, v: Float, scores: Float, step_px: float) -> Float:
    """(K,) offset of the line at each position: the weighted mean of the segments that pass near it.

    Each segment speaks for where it lies, and fades out within a step beyond its ends; u, v are (N, 2).
    """
    slope = (v[:, 1] - v[:, 0]) / np.maximum(u[:, 1] - u[:, 0], 1e-6)
    beyond = np.maximum(np.maximum(u[:, :1] - at, at - u[:, 1:]), 0)  # (N, K)
    weights = scores[:, None] * np.exp(-((beyond / (step_px / 4)) ** 2)) + 1e-12
    # A position outside a segment takes the height of its nearer end, so steep ones do not fly off.
    inside = np.clip(at, u[:, :1], u[:, 1:])
    heights = v[:, :1] + slope[:, None] * (inside - u[:, :1])
    out: Float = (weights * heights).sum(0) / weights.sum(0)
    return out
