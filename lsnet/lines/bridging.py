"""Join chains that continue each other's direction: stretches of one line with an interruption.

Where cables cross, each cell reports only one of them, so the chains of the others end there. Leaves, poles
and insulators interrupt lines too.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

from lsnet.geometry import cross
from lsnet.lines.components import components

if TYPE_CHECKING:
    from lsnet.arrays import Floats, Indices
    from lsnet.lines.polylines import Polylines

FROM_END_PX = 24.0  # the last segments of a chain may lean towards the obstacle
REACH_PX = 80.0  # over which the direction of an end is measured
MAX_OVERLAP_PX = 40.0
MAX_TURN_DEG = 4.0  # between the directions of two ends
OFFSET_PX, OFFSET_PER_PX = 1.0, 0.02  # largest offset from the other's line: fixed, and per px of gap


def group_stretches(lines: Polylines, max_gap_px: float) -> Indices:
    """Assign each polyline to a line; (C,) the number of the line.

    Two ends are joined when they face each other over at most `max_gap_px`, lie on each other's line, and
    each is the other's best match.
    """
    if len(lines) < 2:
        return np.arange(len(lines))
    one, other = _partners(*_ends(lines), max_gap_px)
    first = components(len(lines), np.stack([one, other], axis=1) // 2)
    return np.unique(first, return_inverse=True)[1]


def _ends(lines: Polylines) -> tuple[Floats, Floats]:
    """(2 C, 2) a place near each end, start before end, and (2 C, 2) the outward unit vectors there."""
    length_px = lines.lengths_px
    near_px, far_px = np.minimum(FROM_END_PX, length_px / 4), np.minimum(REACH_PX, 0.9 * length_px)
    at_px = np.stack([near_px, far_px, length_px - near_px, length_px - far_px], axis=1)
    found = lines.at(np.arange(len(length_px))[:, None], at_px).reshape(-1, 2, 2)
    places, between = found[:, 0], found[:, 0] - found[:, 1]
    return places, between / np.hypot(between[:, 0], between[:, 1])[:, None]


def _partners(places: Floats, outwards: Floats, max_gap_px: float) -> tuple[Indices, Indices]:
    """Return the pairs of ends (2 C, 2) that fit, each the other's best match."""
    reach_px = (max_gap_px + 2 * FROM_END_PX + OFFSET_PX) / (1 - OFFSET_PER_PX)
    pairs = cKDTree(places).query_pairs(reach_px, output_type="ndarray")
    pairs = pairs[pairs[:, 0] // 2 != pairs[:, 1] // 2]
    cost = _costs(places[pairs], outwards[pairs], max_gap_px)
    fits = np.isfinite(cost)
    pairs, cost = np.concatenate([pairs[fits], pairs[fits, ::-1]]), np.tile(cost[fits], 2)
    pairs = pairs[np.lexsort((pairs[:, 1], cost, pairs[:, 0]))]
    is_best = np.diff(pairs[:, 0], prepend=-1) > 0
    partner = np.full(len(places), -1)
    partner[pairs[is_best, 0]] = pairs[is_best, 1]
    ends = np.flatnonzero(partner >= 0)
    ends = ends[partner[partner[ends]] == ends]
    return ends, partner[ends]


def _costs(places: Floats, outwards: Floats, max_gap_px: float) -> Floats:
    """(P,) cost of joining P pairs of ends (P, 2, 2), infinite where they do not fit."""
    between = places[:, 1] - places[:, 0]
    one, other = outwards[:, 0], outwards[:, 1]
    # Of each end's place, in the other's direction and aside of it.
    gap = np.minimum((between * one).sum(axis=1), -(between * other).sum(axis=1)) - 2 * FROM_END_PX
    offset = np.maximum(np.abs(cross(one, between)), np.abs(cross(other, between)))
    turn = -(one * other).sum(axis=1)
    fits = (gap <= max_gap_px) & (gap >= -MAX_OVERLAP_PX) & (turn >= np.cos(np.radians(MAX_TURN_DEG)))
    fits &= offset <= OFFSET_PX + OFFSET_PER_PX * np.abs(between).max(axis=1)
    return np.where(fits, offset + 0.1 * np.maximum(gap, 0), np.inf)
