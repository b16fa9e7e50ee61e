"""Join chains that continue each other's direction: stretches of one line with an interruption.

Where cables cross, each cell reports only one of them, so the chains of the others end there. Leaves, poles
and insulators interrupt lines too.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lsnet.arrays import Floats, Indices

FROM_END_PX = 24.0  # the last segments of a chain may lean towards the obstacle
REACH_PX = 80.0  # over which the direction of an end is measured
MAX_OVERLAP_PX = 40.0
MAX_TURN_DEG = 4.0  # between the directions of two ends
OFFSET_PX, OFFSET_PER_PX = 1.0, 0.02  # largest offset from the other's line: fixed, and per px of gap


def group_stretches(polylines: Sequence[Floats], max_gap_px: float) -> Indices:
    """Assign each polyline (K, 2) to a line; (C,) the number of the line.

    Two ends are joined when they face each other over at most `max_gap_px`, lie on each other's line, and
    each is the other's best match.
    """
    count = len(polylines)
    if count < 2:
        return np.arange(count)
    places, outwards = _ends(polylines)
    cost = _costs(places, outwards, max_gap_px)
    partner = cost.argmin(axis=1)
    ends = np.arange(2 * count)
    is_joined = np.isfinite(cost[ends, partner]) & (partner[partner] == ends)
    one, other = ends[is_joined] // 2, partner[is_joined] // 2
    graph = coo_array((np.ones(len(one), np.int8), (one, other)), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1], np.intp)


def _ends(polylines: Sequence[Floats]) -> tuple[Floats, Floats]:
    """(2 C, 2) a place near each end, start before end, and (2 C, 2) the outward unit vectors there."""
    places, outwards = [], []
    for polyline in polylines:
        steps = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(polyline, axis=0).T))])
        near = min(FROM_END_PX, steps[-1] / 4)
        far = min(REACH_PX, 0.9 * steps[-1])
        for at in ((near, far), (steps[-1] - near, steps[-1] - far)):
            place, behind = np.stack([np.interp(at, steps, polyline[:, k]) for k in (0, 1)], axis=1)
            places.append(place)
            outwards.append((place - behind) / np.hypot(*(place - behind)))
    return np.array(places), np.array(outwards)


def _costs(places: Floats, outwards: Floats, max_gap_px: float) -> Floats:
    """(2 C, 2 C) cost of joining each end with each other one, infinite where they do not fit."""
    between = places[None] - places[:, None]
    ahead = (between * outwards[:, None]).sum(-1)  # of the other's place, in this end's direction
    aside = np.abs(outwards[:, None, 0] * between[..., 1] - outwards[:, None, 1] * between[..., 0])
    gap = np.minimum(ahead, ahead.T) - 2 * FROM_END_PX
    offset, turn = np.maximum(aside, aside.T), -(outwards @ outwards.T)
    fits = (gap <= max_gap_px) & (gap >= -MAX_OVERLAP_PX) & (turn >= np.cos(np.radians(MAX_TURN_DEG)))
    fits &= offset <= OFFSET_PX + OFFSET_PER_PX * np.abs(between).max(-1)
    own = np.arange(len(places)) // 2
    fits &= own[:, None] != own
    return np.where(fits, offset + 0.1 * np.maximum(gap, 0), np.inf)
