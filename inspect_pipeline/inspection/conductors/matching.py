"""Match the lines of frames with the conductors of a span: all lines of a frame with all conductors at once.

Where conductors appear close to each other, the nearest one alone says little. Two lines of a frame beside
each other are two conductors.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import linear_sum_assignment

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from inspect_pipeline.arrays import Floats, Ints, Mask
    from inspect_pipeline.inspection.conductors.layout import Place
    from inspect_pipeline.inspection.conductors.sight import SpanSight

NO_CONDUCTOR = -1
_NEAR_PX, _NEAR_SD, _MAX_NEAR_M = 4.0, 2.5, 0.5  # of a conductor's place: nearer lines belong to it
_MIN_LINE_SHARE = 0.4  # of a line near a conductor, from which on all of it belongs to that
_MIN_TRACK_SHARE = 0.5  # the same of a track over all frames, for lines that are near none
# Of a line of a conductor that hangs elsewhere than on other spans: how far, and along how many bins.
_MAX_DISPLACED_M, _MIN_DISPLACED_BINS = 2.5, 4
_BESIDE = 0.3  # of the bins of the shorter one of two lines, that both have: they are two conductors
_MOST_AWAY = 2.5  # times near: lines farther away are of no conductor, if two compete


def match_lines(sight: SpanSight, places: Sequence[Place]) -> Ints:
    """Return the conductor (L,) of each line, or NO_CONDUCTOR."""
    return own_lines(sight, appear(sight, places))


def appear(sight: SpanSight, places: Sequence[Place]) -> Floats:
    """Return where (N, K, B) conductors appear across."""
    return np.stack([sight.appear_at(one.across_m, one.raised_m, one.sag_m) for one in places], axis=1)


def near_m(sight: SpanSight) -> Floats:
    """Return how near to a place (N, B) lines belong to it."""
    with np.errstate(divide="ignore"):
        return np.minimum(_NEAR_SD * sight.noise_m + _NEAR_PX / sight.scale_px, _MAX_NEAR_M)


def own_lines(sight: SpanSight, appears: Floats) -> Ints:
    """Return the conductor (L,) of each line by where conductors appear (N, K, B).

    That is the one nearest to most of it, unless another line beside it is nearer to that: then the two are
    of two conductors. Lines that are near none are of that of their track.
    """
    view, n_lines, n_places = sight.view, len(sight.lines), appears.shape[1]
    votes = np.zeros((n_lines, n_places + 1))
    if not len(view.line):
        return np.full(n_lines, NO_CONDUCTOR)
    away_m = np.abs(view.across_m[:, np.newaxis] - appears[view.frame, :, view.bin])
    limit_m = near_m(sight)[view.frame, view.bin]
    nearest = np.argmin(away_m, axis=1)
    is_near = away_m[np.arange(len(nearest)), nearest] <= limit_m
    np.add.at(votes, (view.line, np.where(is_near, nearest, n_places)), 1.0)
    owner = _winners(votes, _MIN_LINE_SHARE)
    contested = list(_competing(sight, owner))
    if contested:
        costs = np.zeros((n_lines, n_places))
        np.add.at(costs, view.line, np.minimum(away_m / limit_m[:, np.newaxis], _MOST_AWAY) ** 2)
        for lines in contested:
            owner[lines] = _share_out(sight, lines, owner, costs)
    tracks, inverse = np.unique(sight.lines.track, return_inverse=True)
    by_track = np.zeros((len(tracks), n_places + 1))
    np.add.at(by_track, inverse, votes)
    owner = np.where(owner == NO_CONDUCTOR, _winners(by_track, _MIN_TRACK_SHARE)[inverse], owner)
    return _adopt_displaced(sight, owner, away_m)


def _competing(sight: SpanSight, owner: Ints) -> Iterator[Ints]:
    """Yield the lines of each frame in which one conductor has two beside each other."""
    view, n_lines = sight.view, len(owner)
    owned = np.flatnonzero(owner[view.line] != NO_CONDUCTOR)
    n_bins, n_places = len(sight.axis.centres), int(owner.max(initial=0)) + 1
    keys = (view.frame[owned] * n_bins + view.bin[owned]) * n_places + owner[view.line[owned]]
    _, inverse, counts = np.unique(keys, return_inverse=True, return_counts=True)
    is_double = counts[inverse] > 1
    n_doubles = np.bincount(view.line[owned], is_double, n_lines)
    n_crossings = np.bincount(view.line[owned], minlength=n_lines)
    contested = np.unique(sight.lines.frame[n_doubles > _BESIDE * n_crossings])
    with_conductor = np.flatnonzero(owner != NO_CONDUCTOR)
    frames = sight.lines.frame[with_conductor]
    for frame in contested.tolist():
        yield with_conductor[frames == frame]


def _share_out(sight: SpanSight, lines: Ints, owner: Ints, costs: Floats) -> Ints:
    """Return the conductors of the lines of a frame, one for each of those that are beside each other.

    costs (L, K): squared distances of lines from conductors, times their crossings.
    """
    bins = _bins_of(sight, lines)
    groups: list[list[int]] = []  # of pieces of one conductor
    for i in np.argsort(costs[lines, owner[lines]] / bins.sum(axis=1)).tolist():
        same = (g for g in groups if owner[lines[g[0]]] == owner[lines[i]] and not _is_beside(bins, g, i))
        group = next(same, None)
        if group is None:
            groups.append([i])
        else:
            group.append(i)
    totals = np.stack([costs[lines[group]].sum(axis=0) for group in groups])
    none = _MOST_AWAY**2 * np.array([bins[group].sum() for group in groups])
    padded = np.hstack((totals, np.tile(none[:, np.newaxis], len(groups))))
    shared = np.full(len(lines), NO_CONDUCTOR)
    for row, number in zip(*linear_sum_assignment(padded), strict=True):
        if number < costs.shape[1] and totals[row, number] < none[row]:
            shared[groups[row]] = number
    return shared


def _bins_of(sight: SpanSight, lines: Ints) -> Mask:
    """Return which bins lines cross (M, B)."""
    own = np.flatnonzero(np.isin(sight.view.line, lines))
    bins = np.zeros((len(lines), len(sight.axis.centres)), bool)
    bins[np.searchsorted(lines, sight.view.line[own]), sight.view.bin[own]] = True
    return bins


def _is_beside(bins: Mask, group: Sequence[int], i: int) -> bool:
    """Return whether a line has bins in common with those of a group."""
    theirs = bins[group].any(axis=0)
    least = min(theirs.sum(), bins[i].sum())
    return bool(np.count_nonzero(theirs & bins[i]) > _BESIDE * least)


def _adopt_displaced(sight: SpanSight, owner: Ints, away_m: Floats) -> Ints:
    """Give lines that are near no place to the nearest conductor that their frame lacks: it was moved.

    away_m (C, K): from crossings to the places of conductors.
    """
    view, n_places = sight.view, away_m.shape[1]
    adopted = owner.copy()
    sums = np.zeros((len(owner), n_places))
    np.add.at(sums, view.line, away_m)
    n_crossings = np.bincount(view.line, minlength=len(owner))
    mean_m = sums / np.maximum(n_crossings, 1)[:, np.newaxis]
    taken = np.zeros((len(sight.rows), n_places), bool)
    owned = np.flatnonzero(owner != NO_CONDUCTOR)
    taken[sight.lines.frame[owned], owner[owned]] = True
    for line in np.flatnonzero((owner == NO_CONDUCTOR) & (n_crossings >= _MIN_DISPLACED_BINS)).tolist():
        free = np.where(taken[sight.lines.frame[line]], np.inf, mean_m[line])
        nearest = int(np.argmin(free))
        if free[nearest] <= _MAX_DISPLACED_M:
            adopted[line] = nearest
    return adopted


def _winners(votes: Floats, min_share: float) -> Ints:
    """Return the column, other than the last, with most of each row's votes; NO_CONDUCTOR with too few."""
    best = np.argmax(votes[:, :-1], axis=1)
    most = votes[np.arange(len(votes)), best]
    return np.where((most > 0) & (most >= min_share * votes.sum(axis=1)), best, NO_CONDUCTOR)
