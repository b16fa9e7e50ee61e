"""Votes of frames on where each conductor of a span is present.

A frame says nothing about a conductor in a bin that it does not show, shows too coarsely, or in which
another conductor appears within a few pixels.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import maximum_filter1d

from inspect_pipeline.inspection.conductors.matching import NO_CONDUCTOR, appear, near_m, own_lines

if TYPE_CHECKING:
    from collections.abc import Sequence

    from inspect_pipeline.arrays import Floats, Ints, Mask
    from inspect_pipeline.inspection.conductors.layout import Place
    from inspect_pipeline.inspection.conductors.sight import SpanSight
    from inspect_pipeline.inspection.rules import Rules

_APART = 1.2  # times what is near a conductor's place: nearer conductors say nothing of each other
_ALONE = 1.7  # times that: of conductors nearer than this, the other must have a line in the frame
_MISSED_WEIGHT = 0.5  # of a frame in which a conductor was found nowhere: it may have been missed
_END_BINS = 1  # beside a gap: frames show its ends one bin nearer or farther
_MIN_DEPTH_M = 0.5  # of conductors below the camera
_MIN_FOUND = 0.5  # of the conductors that a frame shows; others of poor detection or pose say nothing


@dataclass(frozen=True, eq=False)
class Votes:
    """Votes on the K conductors of a span in its B bins.

    owner (L,): the conductor that each line belongs to, or NO_CONDUCTOR. in_frame (N, K): whether a frame has
    a line of it. weight, against (N, K, B): of a frame's vote on a bin, and of its votes that a conductor is
    absent. found (K, B): the share of the weight that a line is found with, before errors of positions are
    allowed for. hidden (K, B): views that another conductor spoils, as a share.
    """

    owner: Ints
    in_frame: Mask
    weight: Floats
    against: Floats
    found: Floats
    hidden: Floats


def count_votes(sight: SpanSight, places: Sequence[Place], rules: Rules) -> Votes:
    """Return the votes of all frames on conductors at known places."""
    appears = appear(sight, places)  # (N, K, B)
    owner = own_lines(sight, appears)
    bins, is_shown = _shown_bins(sight, places, appears, rules)
    crossed = _find_crossings(sight, appears, owner)
    found, apart = (
        np.take_along_axis(mask, bins, axis=2)
        for mask in (crossed, _are_told_apart(sight, appears, crossed, rules))
    )
    visible = is_shown & ~sight.coarse[:, np.newaxis]
    present: Mask = found & visible
    in_frame = np.asarray(present.any(axis=2))
    with np.errstate(invalid="ignore"):
        fineness = np.clip(1.5 - sight.gsd_m / rules.coverage["max_gsd_m"], 0.5, 1.0)
    says: Mask = visible & apart
    weight = np.where(says, np.nan_to_num(fineness)[:, np.newaxis], 0.0)
    weight *= np.where(in_frame, 1.0, _MISSED_WEIGHT)[:, :, np.newaxis]
    weight[_share_found(in_frame, says) < _MIN_FOUND] = 0.0
    hidden = np.asarray(visible & ~says).sum(axis=0) / np.maximum(visible.sum(axis=0), 1)
    missed: Mask = ~present & visible
    if not sight.widened_bins:  # else that counts as absent
        weight[present & _widen(missed & _is_between(present), _END_BINS)] = 0.0
    absent = _widen(missed, sight.widened_bins)
    share = (weight * present).sum(axis=0) / np.maximum(weight.sum(axis=0), 1e-9)
    return Votes(owner, in_frame, weight, np.where(absent, weight, 0.0), share, hidden)


def _is_between(present: Mask) -> Mask:
    """Return what is between the first and the last bin (N, K, B) with a line, in each frame."""
    backwards = np.logical_or.accumulate(present[..., ::-1], axis=2)[..., ::-1]
    return np.asarray(np.logical_or.accumulate(present, axis=2) & backwards)


def _widen(absent: Mask, n_bins: int) -> Mask:
    """Return absent stretches (N, K, B) widened at both ends, by as much as errors of positions blur them."""
    if not n_bins:
        return absent
    return np.asarray(maximum_filter1d(absent, 2 * n_bins + 1, axis=2, mode="constant"))


def _find_crossings(sight: SpanSight, appears: Floats, owner: Ints) -> Mask:
    """Return where (N, K, B) a line of a conductor crosses a bin: one it owns, else one near its place."""
    view = sight.view
    found = np.zeros(appears.shape, bool)
    if len(view.line):
        away_m = np.abs(view.across_m[:, np.newaxis] - appears[view.frame, :, view.bin])
        nearest = np.argmin(away_m, axis=1)
        is_near = away_m[np.arange(len(nearest)), nearest] <= near_m(sight)[view.frame, view.bin]
        number = owner[view.line]
        number = np.where((number == NO_CONDUCTOR) & is_near, nearest, number)
        known = number != NO_CONDUCTOR
        found[view.frame[known], number[known], view.bin[known]] = True
    return found


def _shown_bins(
    sight: SpanSight, places: Sequence[Place], appears: Floats, rules: Rules
) -> tuple[Ints, Mask]:
    """Return in which bin (N, K, B) each bin of a conductor appears, and whether a frame shows it.

    A conductor above or below the nominal height appears nearer or farther along than it is.
    """
    axis = sight.axis
    bins = np.zeros(appears.shape, np.int64)
    shown = np.zeros(bins.shape, bool)
    is_in_view = np.isfinite(sight.view.gsd_m)
    for k, place in enumerate(places):
        number = _appear_in(sight, place.raised_m - place.sag_m * sight.parabola)
        is_inside = (number >= 0) & (number < len(axis.centres))
        bins[:, k] = np.clip(number, 0, len(axis.centres) - 1)
        is_visible = is_in_view & _is_visible(sight, appears[:, k], rules.anomalies["margin_px"])
        shown[:, k] = is_inside & np.take_along_axis(is_visible, bins[:, k], axis=1)
    return bins, shown


def _appear_in(sight: SpanSight, lifted_m: Floats) -> Ints:
    """Return the bin (N, B) at the nominal height in which each bin of a higher conductor appears."""
    axis, from_m = sight.axis, sight.from_m[:, np.newaxis]
    ratio = sight.above_m / np.maximum(sight.above_m - lifted_m, _MIN_DEPTH_M)
    along_m = from_m + (axis.bins_m - from_m) * ratio
    with np.errstate(invalid="ignore"):
        return np.nan_to_num(np.round(along_m / axis.bin_m - 0.5), nan=-1.0).astype(np.int64)


def _is_visible(sight: SpanSight, across_m: Floats, margin_px: float) -> Mask:
    """Return where (N, B) an image has what is somewhere across (N, B), not next to its border.

    That is where lines were projected from, as recorded: whatever a conductor's height, its line is there.
    """
    axis, cameras = sight.axis, sight.cameras
    side_m = ((cameras.positions[:, :2] - axis.start) @ axis.across)[:, np.newaxis]
    with np.errstate(invalid="ignore"):
        scale = sight.above_m / (cameras.positions[:, 2:] - axis.centres[:, 2])
        recorded_m = side_m + (across_m - sight.side_m[:, np.newaxis]) / scale
        points = axis.centres + recorded_m[..., np.newaxis] * np.append(axis.across, 0.0)
        pixels, depths = cameras.project(points)
        limits = cameras.sizes[:, np.newaxis] - margin_px
        return np.asarray((depths > 0) & ((pixels >= margin_px) & (pixels < limits)).all(axis=-1))


def _are_told_apart(sight: SpanSight, appears: Floats, found: Mask, rules: Rules) -> Mask:
    """Return where (N, K, B) a frame tells a conductor from its neighbours in the image, there or not.

    They appear some pixels away, or a little less where each has a line of its own.
    """
    order = np.argsort(appears, axis=1)
    apart_px = np.diff(np.take_along_axis(appears, order, axis=1), axis=1) * sight.scale_px[:, np.newaxis]
    near_px = (near_m(sight) * sight.scale_px)[:, np.newaxis]
    least_px = np.maximum(rules.anomalies["aligned_px"], _APART * near_px)
    has_line = np.take_along_axis(found, order, axis=1)
    clear = apart_px >= _ALONE * near_px
    apart = np.ones(appears.shape, bool)
    apart[:, 1:] &= (apart_px >= least_px) & (clear | has_line[:, :-1])
    apart[:, :-1] &= (apart_px >= least_px) & (clear | has_line[:, 1:])
    told = np.zeros(appears.shape, bool)
    np.put_along_axis(told, order, apart, axis=1)
    return told


def apart_px(sight: SpanSight, first: Place, second: Place) -> Floats:
    """Return how far two conductors appear from each other (N, B), in pixels."""
    appears = appear(sight, (first, second))
    return np.asarray(np.abs(appears[:, 0] - appears[:, 1]) * sight.scale_px)


def _share_found(in_frame: Mask, judged: Mask) -> Floats:
    """Return which share (N,) of the conductors that a frame can judge it has."""
    can_judge = judged.any(axis=2)
    return np.asarray((in_frame & can_judge).sum(axis=1) / np.maximum(can_judge.sum(axis=1), 1))
