"""Stretches of one line that something interrupts: chains that go on in each other's direction are joined.

Where cables cross, each cell can say one of them only, so the chains of the others end there; so they do at
leaves, poles and insulators.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Float = NDArray[np.float64]
    Int = NDArray[np.intp]

FROM_END_PX = 24.0  # the last segments of a chain may lean towards what interrupts it
REACH_PX = 80.0  # over which the direction of an end is taken
MOST_OVERLAP_PX = 40.0
MAX_TURN_DEG = 4.0  # between the directions of two ends
OFFSET_PX, OFFSET_PER_PX = 1.0, 0.02  # how far beside the other's line an end may lie, with the gap


def bridged(polylines: Sequence[Float], max_gap_px: float) -> Int:
    """(C,) for each polyline (K, 2) the number of the line it is a stretch of.

    Two ends are joined when they face each other over at most `max_gap_px`, lie on each other's line, and
    neither has a better partner.
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


def _ends(polylines: Sequence[Float]) -> tuple[Float, Float]:
    """(2 C, 2) a place near each end, start before end, and (2 C, 2) the unit vector outwards there."""
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


def _costs(places: Float, outwards: Float, max_gap_px: float) -> Float:
    """(2 C, 2 C) how badly each end goes on in each other one, infinite where it does not."""
    between = places[None] - places[:, None]
    ahead = (between * outwards[:, None]).sum(-1)  # of the other's place, in one's own direction
    aside = np.abs(outwards[:, None, 0] * between[..., 1] - outwards[:, None, 1] * between[..., 0])
    gap = np.minimum(ahead, ahead.T) - 2 * FROM_END_PX
    offset, turn = np.maximum(aside, aside.T), -(outwards @ outwards.T)
    fits = (gap <= max_gap_px) & (gap >= -MOST_OVERLAP_PX) & (turn >= np.cos(np.radians(MAX_TURN_DEG)))
    fits &= offset <= OFFSET_PX + OFFSET_PER_PX * np.abs(between).max(-1)
    own = np.arange(len(places)) // 2
    fits &= own[:, None] != own
    return np.where(fits, offset + 0.1 * np.maximum(gap, 0), np.inf)
