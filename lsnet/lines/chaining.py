"""Chain the overlapping segments of the four grids into polylines.

Two segments are linked when they have nearly the same direction, lie on each other's line, and touch or
nearly touch. Linked segments form a chain; its polyline is the score-weighted mean of the segments along it.
The odds of a line are the odds of its segments times its length, each cell along it being further evidence,
unless a learned score (`lsnet.lines.score`) rates it.

All chains of an image are processed at once, in arrays with the number of the chain beside each value.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np
from scipy.spatial import cKDTree

from lsnet.geometry import angle_between, cross, length, orientation
from lsnet.lines.bridging import group_stretches
from lsnet.lines.fitting import ChainFits, Chains, fit_chains
from lsnet.lines.proposals import Proposals
from lsnet.lines.quantiles import group_quantiles
from lsnet.segments import Detections, Lines, Segments

if TYPE_CHECKING:
    from lsnet.arrays import Floats, Floats32, Indices
    from lsnet.lines.proposals import Rate

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


def chain_segments(
    segments: Segments,
    config: ChainingConfig,
    enlargement: float = 1.0,
    rate: Rate | None = None,
    min_score: float = 0.0,
) -> Detections:
    """Merge the segments of one image into lines.

    Args:
        segments: What the cells report.
        config: What counts as one line.
        enlargement: Factor by which the image was enlarged before detection.
        rate: Returns the scores of proposals. Default: the odds of their segments times their length.
        min_score: Lines with a lower score are left out.

    Returns:
        The given segments, the lines with the highest score first, and the line of each segment.
    """
    strong = np.flatnonzero(segments.scores >= config.min_segment_score)
    proposals, chains = propose_lines(segments.above(config.min_segment_score), enlargement, config)
    scores = proposals.prior if rate is None or not len(proposals) else rate(proposals)
    order = np.argsort(-scores, kind="stable")
    order = order[scores[order] >= min_score]
    rank = np.full(len(scores), -1, np.int32)
    rank[order] = np.arange(len(order))
    line_of = np.full(len(segments), -1, np.int32)
    line_of[strong[chains.members]] = rank[chains.number]
    points = tuple(_simplified(proposals.polylines[i], config) for i in order)
    lines = Lines(points, scores[order].astype(np.float32), segments.image_size)
    return Detections(segments, lines, line_of)


def propose_lines(segments: Segments, enlargement: float, config: ChainingConfig) -> tuple[Proposals, Chains]:
    """Chain segments; return the proposals, and their chains."""
    ends, scores = segments.endpoints.astype(float), segments.scores.astype(float)
    chains, fit = _chain(ends, scores, config)
    proposals = Proposals(
        polylines=fit.polylines,
        prior=_prior(fit, min(segments.image_size) / enlargement, config),
        mean_score=fit.mean_score,
        support=fit.support,
        extent_px=fit.extent_px,
        spread_px=fit.spread_px,
        quantiles=group_quantiles(scores[chains.members], chains.first, (0.1, 0.5, 0.9)),
        image_size=segments.image_size,
        enlargement=enlargement,
    )
    return proposals, chains


def _prior(fit: ChainFits, shorter_side_px: float, config: ChainingConfig) -> Floats:
    """(C,) score of each line: odds of its segments times its supported length over the reference.

    A large view has more places for false lines, so the length that a line needs grows with the image.
    """
    reference_px = np.clip(config.reference_length * shorter_side_px, *REFERENCE_LENGTHS_PX)
    mean_score = np.clip(fit.mean_score, MIN_DOUBT, 1 - MIN_DOUBT)
    supported_px = fit.extent_px * np.minimum(fit.support / config.full_support, 1)
    odds = mean_score / (1 - mean_score) * supported_px / reference_px
    out: Floats = odds / (1 + odds)
    return out


def _chain(ends: Floats, scores: Floats, config: ChainingConfig) -> tuple[Chains, ChainFits]:
    """Chain segments (N, 4) with scores (N,).

    Cables a few pixels apart can end up in one chain. Its segments then lie on both sides of its
    polyline, and they are linked again with a smaller tolerance.
    """
    chains, fit = _chain_straight(ends, scores, config)
    labels = group_stretches(fit.polylines, config.max_bridge_px)
    if labels.max(initial=-1) + 1 < len(labels):
        chains = chains.joined(labels)
        fit = fit_chains(ends, scores, chains, config.step_px)
    return chains, fit


def _chain_straight(ends: Floats, scores: Floats, config: ChainingConfig) -> tuple[Chains, ChainFits]:
    """Chain linked segments."""
    pairs, offsets = _link(ends, config)
    found: list[tuple[Chains, ChainFits]] = []
    left, tolerance_px = np.arange(len(ends)), config.max_offset_px
    while True:
        chains = Chains.connected(ends, pairs[offsets <= tolerance_px], left, config.min_length_px)
        fit = fit_chains(ends, scores, chains, config.step_px)
        is_wide = (fit.spread_px > config.max_spread_px) & (tolerance_px > MIN_OFFSET_PX)
        is_kept = ~is_wide & (fit.extent_px >= config.min_length_px)
        if not found and is_kept.all():
            return chains, fit
        found.append((chains.chosen(is_kept), fit.chosen(is_kept)))
        if not is_wide.any():
            parts, fits = zip(*found, strict=True)
            return Chains.together(parts), ChainFits.together(fits)
        left = chains.members[is_wide[chains.number]]
        is_left = np.zeros(len(ends), bool)
        is_left[left] = True
        is_linked = is_left[pairs].all(axis=1)
        pairs, offsets = pairs[is_linked], offsets[is_linked]
        tolerance_px *= TIGHTENING


def _simplified(polyline: Floats, config: ChainingConfig) -> Floats32:
    points = polyline.astype(np.float32)[:, None]
    return np.asarray(cv2.approxPolyDP(points, config.flatness_px, closed=False)[:, 0], np.float32)


def _link(ends: Floats, config: ChainingConfig) -> tuple[Indices, Floats]:
    """Find the pairs of segments (N, 4) that may be linked.

    Returns:
        (P, 2) pairs of segments, and (P,) the larger distance of one's midpoint from the other's line, px.
    """
    middles, lengths = (ends[:, :2] + ends[:, 2:]) / 2, np.maximum(length(ends), 1e-9)
    directions, angles = (ends[:, 2:] - ends[:, :2]) / lengths[:, None], orientation(ends)
    pairs = cKDTree(middles).query_pairs(lengths.max(initial=0) + config.max_gap_px, output_type="ndarray")
    # The test that leaves the fewest pairs comes first.
    one = np.ascontiguousarray(pairs[:, 0])
    x, y = (middles[pairs[:, 1], k] - middles[one, k] for k in (0, 1))
    pairs = pairs[np.abs(directions[one, 0] * y - directions[one, 1] * x) <= config.max_offset_px]
    i, j = pairs.T
    between = middles[j] - middles[i]
    offsets = np.maximum(np.abs(cross(directions[i], between)), np.abs(cross(directions[j], between)))
    gaps = np.abs((directions[i] * between).sum(1)) - (lengths[i] + lengths[j]) / 2
    is_linked = (offsets <= config.max_offset_px) & (gaps <= config.max_gap_px)
    is_linked &= angle_between(angles[i], angles[j]) <= np.radians(config.max_angle_deg)
    return pairs[is_linked], offsets[is_linked]
