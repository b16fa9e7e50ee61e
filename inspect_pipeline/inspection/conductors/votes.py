"""Votes of frames on where each conductor of a span is present.

A frame says nothing about a conductor in a bin that it does not show, shows too coarsely, or in which
another conductor appears within a few pixels.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import maximum_filter1d

from inspect_pipeline.inspection.span_view import visible_gsd_m

if TYPE_CHECKING:
    from collections.abc import Sequence

    from inspect_pipeline.arrays import Floats, Ints, Mask
    from inspect_pipeline.inspection.conductors.layout import Place
    from inspect_pipeline.inspection.conductors.sight import SpanSight
    from inspect_pipeline.inspection.rules import Rules

NO_CONDUCTOR = -1
_NEAR_PX, _NEAR_SD, _MAX_NEAR_M = 4.0, 2.5, 0.5  # of a conductor's place: nearer lines belong to it
_APART = 1.2  # times that: nearer conductors say nothing of each other
_ALONE = 1.7  # times that: of conductors nearer than this none is said to be absent
_MIN_LINE_SHARE = 0.4  # of a line near a conductor, from which on all of it belongs to that
_MIN_TRACK_SHARE = 0.5  # the same of a track over all frames, for lines that are near none
# Of a line of a conductor that hangs elsewhere than on other spans: how far, and along how many bins.
_MAX_DISPLACED_M, _MIN_DISPLACED_BINS = 2.5, 4
_MISSED_WEIGHT = 0.5  # of a frame in which a conductor was found nowhere: it may have been missed
_MIN_DEPTH_M = 0.5  # of conductors below the camera
_MIN_FOUND = 0.5  # of the conductors that a frame shows; others of poor detection or pose say nothing


@dataclass(frozen=True, eq=False)
class Votes:
    """Votes on the K conductors of a span in its B bins.

    owner (L,): the conductor that each line belongs to, or NO_CONDUCTOR. in_frame (N, K): whether a frame has
    a line of it. weight, against (N, K, B): of a frame's vote on a bin, and of its votes that a conductor is
    absent. hidden (K, B): views that another conductor spoils, as a share.
    """

    owner: Ints
    in_frame: Mask
    weight: Floats
    against: Floats
    hidden: Floats


def assign_lines(sight: SpanSight, places: Sequence[Place]) -> Ints:
    """Return the conductor (L,) of each line, or NO_CONDUCTOR."""
    return _own_lines(sight, _appear(sight, places))


def count_votes(sight: SpanSight, places: Sequence[Place], rules: Rules) -> Votes:
    """Return the votes of all frames on conductors at known places."""
    appears = _appear(sight, places)  # (N, K, B)
    owner = _own_lines(sight, appears)
    bins, is_shown = _shown_bins(sight, places, rules)
    near_px = _near_m(sight) * sight.scale_px
    found, isolated, is_alone = (
        np.take_along_axis(mask, bins, axis=2)
        for mask in (
            _find_crossings(sight, appears, owner),
            _are_isolated(
                appears, sight.scale_px, np.maximum(rules.anomalies["aligned_px"], _APART * near_px)
            ),
            _are_isolated(appears, sight.scale_px, _ALONE * near_px),
        )
    )
    visible = is_shown & ~sight.coarse[:, np.newaxis]
    present: Mask = found & visible
    in_frame = np.asarray(present.any(axis=2))
    with np.errstate(invalid="ignore"):
        fineness = np.clip(1.5 - sight.gsd_m / rules.coverage["max_gsd_m"], 0.5, 1.0)
    says: Mask = visible & isolated & (present | is_alone)
    weight = np.where(says, np.nan_to_num(fineness)[:, np.newaxis], 0.0)
    weight *= np.where(in_frame, 1.0, _MISSED_WEIGHT)[:, :, np.newaxis]
    weight[_share_found(in_frame, says) < _MIN_FOUND] = 0.0
    hidden = np.asarray(visible & ~says).sum(axis=0) / np.maximum(visible.sum(axis=0), 1)
    absent = _widen(~present & visible, sight.widened_bins)
    return Votes(owner, in_frame, weight, np.where(absent, weight, 0.0), hidden)


def _widen(absent: Mask, n_bins: int) -> Mask:
    """Return absent stretches (N, K, B) widened at both ends, by as much as errors of positions blur them."""
    if not n_bins:
        return absent
    return np.asarray(maximum_filter1d(absent, 2 * n_bins + 1, axis=2, mode="constant"))


def _appear(sight: SpanSight, places: Sequence[Place]) -> Floats:
    """Return where (N, K, B) conductors appear across."""
    return np.stack([sight.appear_at(one.across_m, one.raised_m, one.sag_m) for one in places], axis=1)


def _find_crossings(sight: SpanSight, appears: Floats, owner: Ints) -> Mask:
    """Return where (N, K, B) a line of a conductor crosses a bin: one near its place, else one it owns."""
    view = sight.view
    found = np.zeros(appears.shape, bool)
    if len(view.line):
        away_m = np.abs(view.across_m[:, np.newaxis] - appears[view.frame, :, view.bin])
        nearest = np.argmin(away_m, axis=1)
        is_near = away_m[np.arange(len(nearest)), nearest] <= _near_m(sight)[view.frame, view.bin]
        number = np.where(is_near, nearest, owner[view.line])
        known = number != NO_CONDUCTOR
        found[view.frame[known], number[known], view.bin[known]] = True
    return found


def _shown_bins(sight: SpanSight, places: Sequence[Place], rules: Rules) -> tuple[Ints, Mask]:
    """Return in which bin (N, K, B) each bin of a conductor appears, and whether a frame shows it.

    A conductor above or below the nominal height appears nearer or farther along than it is.
    """
    axis = sight.axis
    bins = np.zeros((len(sight.rows), len(places), len(axis.centres)), np.int64)
    shown = np.zeros(bins.shape, bool)
    for k, place in enumerate(places):
        lifted_m = place.raised_m - place.sag_m * sight.parabola
        ratio = sight.above_m / np.maximum(sight.above_m - lifted_m, _MIN_DEPTH_M)
        along_m = sight.from_m[:, np.newaxis] + (axis.bins_m - sight.from_m[:, np.newaxis]) * ratio
        with np.errstate(invalid="ignore"):
            number = np.nan_to_num(np.round(along_m / axis.bin_m - 0.5), nan=-1.0).astype(np.int64)
        is_inside = (number >= 0) & (number < len(axis.centres))
        points = axis.centres + np.column_stack(
            (np.outer(np.full(len(lifted_m), place.across_m), axis.across), lifted_m)
        )
        gsd_m = visible_gsd_m(sight.cameras, points, rules.anomalies["margin_px"])
        bins[:, k] = np.clip(number, 0, len(axis.centres) - 1)
        shown[:, k] = is_inside & np.isfinite(gsd_m)
    return bins, shown


def _near_m(sight: SpanSight) -> Floats:
    """Return how near to a place (N, B) lines belong to it."""
    with np.errstate(divide="ignore"):
        return np.minimum(_NEAR_SD * sight.noise_m + _NEAR_PX / sight.scale_px, _MAX_NEAR_M)


def _own_lines(sight: SpanSight, appears: Floats) -> Ints:
    """Return the conductor (L,) of each line: the one nearest to most of it, else that of its track."""
    view, n_lines, n_places = sight.view, len(sight.lines), appears.shape[1]
    votes = np.zeros((n_lines, n_places + 1))
    if not len(view.line):
        return np.full(n_lines, NO_CONDUCTOR)
    away_m = np.abs(view.across_m[:, np.newaxis] - appears[view.frame, :, view.bin])
    nearest = np.argmin(away_m, axis=1)
    is_near = away_m[np.arange(len(nearest)), nearest] <= _near_m(sight)[view.frame, view.bin]
    np.add.at(votes, (view.line, np.where(is_near, nearest, n_places)), 1.0)
    by_line = _winners(votes, _MIN_LINE_SHARE)
    tracks, inverse = np.unique(sight.lines.track, return_inverse=True)
    by_track = np.zeros((len(tracks), n_places + 1))
    np.add.at(by_track, inverse, votes)
    owner = np.where(by_line == NO_CONDUCTOR, _winners(by_track, _MIN_TRACK_SHARE)[inverse], by_line)
    return _adopt_displaced(sight, owner, away_m)


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


def _are_isolated(appears: Floats, scale_px: Floats, least_px: Floats) -> Mask:
    """Return where (N, K, B) no other conductor appears within some pixels (N, B)."""
    order = np.argsort(appears, axis=1)
    apart_px = np.diff(np.take_along_axis(appears, order, axis=1), axis=1) * scale_px[:, np.newaxis]
    far = np.full((appears.shape[0], 1, appears.shape[2]), np.inf)
    nearest = np.minimum(np.concatenate((far, apart_px), axis=1), np.concatenate((apart_px, far), axis=1))
    isolated = np.zeros(appears.shape, bool)
    np.put_along_axis(isolated, order, nearest >= least_px[:, np.newaxis], axis=1)
    return isolated


def apart_px(sight: SpanSight, first: Place, second: Place) -> Floats:
    """Return how far two conductors appear from each other (N, B), in pixels."""
    appears = _appear(sight, (first, second))
    return np.asarray(np.abs(appears[:, 0] - appears[:, 1]) * sight.scale_px)


def _share_found(in_frame: Mask, judged: Mask) -> Floats:
    """Return which share (N,) of the conductors that a frame can judge it has."""
    can_judge = judged.any(axis=2)
    return np.asarray((in_frame & can_judge).sum(axis=1) / np.maximum(can_judge.sum(axis=1), 1))
