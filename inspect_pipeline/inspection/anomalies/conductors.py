"""Rules about sag of conductors and distances between them.

A view from one side cannot distinguish a conductor that hangs lower from one that is farther away. A parabola
over the whole span is taken as sag, any other shape as a change across.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from inspect_pipeline.inspection.anomalies.frames import Finding
from inspect_pipeline.inspection.rows import find_runs

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from inspect_pipeline.arrays import Floats, Ints, Mask
    from inspect_pipeline.geometry.local_frame import LocalMetres
    from inspect_pipeline.inspection.rules import Rules
    from inspect_pipeline.inspection.span_evidence import SpanEvidence


_MAX_UNKNOWN_BINS = 3
_USUAL_QUANTILE = 0.8  # of the distances of two conductors along the span, taken as usual
_RAISED_M = 0.5  # standard deviation of the heights of the conductors of a span
_NOISE_M = 0.05  # standard deviation of a crossing
_ITERATIONS = 8
_MIN_DEPTH_M = 1.0
_MISFIT_QUANTILE = 0.8
MIN_SAGS = 3  # conductors whose sag is compared
_MIN_FITTING = 0.85  # of the crossings of a track; else it has parts of two conductors


@dataclass(frozen=True, slots=True, eq=False)
class ConductorTrack:
    """A track along a span.

    keys (C,): frame * B + bin of its crossings, ascending. across_m (C,): where it crosses. sag_m: of a
    parabola fitted to it, misfit_m: its distance from that. Both are NaN where too little of it is visible or
    the track has parts of two conductors.
    """

    track: int
    keys: Ints
    across_m: Floats
    sag_m: float
    misfit_m: float


@dataclass(frozen=True, slots=True, eq=False)
class LinesOfSight:
    """Lines of sight (C,): camera position along, aside and above the plane, and slopes per metre down."""

    from_m: Floats
    side_m: Floats
    above_m: Floats
    ahead: Floats
    slope: Floats

    def select(self, chosen: Mask) -> LinesOfSight:
        """Return some of them."""
        return LinesOfSight(*(getattr(self, name)[chosen] for name in self.__slots__))


def conductor_tracks(one: SpanEvidence, rules: Rules) -> list[ConductorTrack]:
    """Return the conductors of a span, and tracks that belong to none, with the sag of those visible enough."""
    view, axis = one.sight.view, one.axis
    groups = _group_lines(one)[view.line]
    lines_of_sight = _lines_of_sight(one)
    conductors = []
    for group in np.unique(groups).tolist():
        own = groups == group
        track = int(np.median(one.sight.lines.track[view.line[own]]))
        visible_m = len(np.unique(view.bin[own])) * axis.bin_m
        is_enough = visible_m >= rules.of("sag_change")["min_share"] * axis.length_m
        fit = _fit_sag(lines_of_sight.select(own), axis.length_m) if is_enough else (np.nan, np.nan)
        keys, once = np.unique(view.frame[own] * len(axis.centres) + view.bin[own], return_index=True)
        conductors.append(ConductorTrack(track, keys, view.across_m[own][once], *fit))
    return conductors


def _group_lines(one: SpanEvidence) -> Ints:
    """Return a number (L,) for each line: of its conductor, else of its track."""
    _, by_track = np.unique(one.sight.lines.track, return_inverse=True)
    if one.votes is None:
        return by_track
    return np.where(one.votes.owner >= 0, one.votes.owner, len(one.places) + by_track)


def _distances_m(first: ConductorTrack, second: ConductorTrack, n_bins: int, rules: Rules) -> Floats:
    """Return distances across (B,) over the frames with both conductors, NaN where too few have."""
    both, i, j = np.intersect1d(first.keys, second.keys, assume_unique=True, return_indices=True)
    return _median_by_bin(np.abs(first.across_m[i] - second.across_m[j]), both % n_bins, n_bins, rules)


def _lines_of_sight(one: SpanEvidence) -> LinesOfSight:
    """Return the line of sight of each crossing of a view."""
    axis, view = one.axis, one.sight.view
    from_m, side_m = one.sight.from_m[view.frame], one.sight.side_m[view.frame]
    above_m = one.sight.above_m[view.frame, view.bin]  # above the nominal conductor, which sags
    return LinesOfSight(
        from_m=from_m,
        side_m=side_m,
        above_m=above_m + (axis.centres[view.bin, 2] - axis.chord_m[view.bin]),
        ahead=(axis.bins_m[view.bin] - from_m) / above_m,
        slope=(view.across_m - side_m) / above_m,
    )


def _fit_sag(sight: LinesOfSight, length_m: float) -> tuple[float, float]:
    """Return the sag of a conductor in the middle of its span, and the misfit, in metres.

    A conductor at y across, e above the plane and with sag s is visible at a slope q across per metre down:
    q = (y - side) / (above - e + s p), with p = 4 x (1 - x) at a share x of the span, where x depends on the
    depth. Solved by Gauss-Newton with a prior e = 0, without outliers.
    """
    y_m = float(np.median(sight.side_m + sight.slope * sight.above_m))
    raised_m = sag_m = 0.0
    fits = np.ones(len(sight.slope), bool)
    depth_m, parabola = sight.above_m, np.zeros(len(fits))
    for _ in range(_ITERATIONS):
        share = np.clip((sight.from_m + sight.ahead * depth_m) / length_m, 0, 1)
        parabola = 4 * share * (1 - share)
        depth_m = sight.above_m - raised_m + sag_m * parabola
        slope = (y_m - sight.side_m) / depth_m
        # Residuals in metres across, at the depth of the conductor.
        terms = np.column_stack((np.ones_like(slope), slope, -slope * parabola))[fits]
        residuals = ((sight.slope - slope) * depth_m)[fits]
        weight = np.sqrt(len(residuals)) * _NOISE_M / _RAISED_M
        rows = np.vstack((terms, [0.0, weight, 0.0]))
        step = np.linalg.lstsq(rows, np.append(residuals, -weight * raised_m), rcond=None)[0]
        y_m, raised_m, sag_m = (np.array([y_m, raised_m, sag_m]) + step).tolist()
        depth_m = np.maximum(sight.above_m - raised_m + sag_m * parabola, _MIN_DEPTH_M)
        away = np.abs(sight.slope * depth_m - (y_m - sight.side_m))
        fits = away <= 4 * max(float(np.median(away)), 0.01)
    if fits.mean() < _MIN_FITTING:
        return float("nan"), float("nan")
    return sag_m, float(np.quantile(away, _MISFIT_QUANTILE))


def _median_by_bin(across_m: Floats, bins: Ints, n_bins: int, rules: Rules) -> Floats:
    """Return the median of each bin (B,), NaN with too few values or where views disagree."""
    medians = np.full(n_bins, np.nan)
    order = np.argsort(bins, kind="stable")
    edges = np.flatnonzero(np.diff(bins[order])) + 1
    for group in np.split(order, edges) if len(order) else ():
        if len(group) < rules.of("conductors_converging")["min_views"]:
            continue
        low, middle, high = np.quantile(across_m[group], (0.1, 0.5, 0.9))
        if high - low <= rules.of("conductors_converging")["max_spread_m"]:
            medians[bins[group[0]]] = middle
    return medians


def find_converging(
    one: SpanEvidence, conductors: Sequence[ConductorTrack], origin: LocalMetres, rules: Rules
) -> Iterator[Finding]:
    """Find the two conductors that come closest relative to their usual distance."""
    found = [
        _to_finding(one, approach, first.track, origin)
        for i, first in enumerate(conductors)
        for second in conductors[i + 1 :]
        for approach in _approaches(_distances_m(first, second, len(one.axis.centres), rules), one, rules)
    ]
    # A conductor that moves towards its neighbour also approaches those behind it.
    if found:
        yield max(found, key=lambda one: one.threshold - one.value)


class _Approach(NamedTuple):
    """Bins in which two conductors are closer than a limit, their least and their usual distance."""

    bins: Ints
    least_m: float
    limit_m: float
    usual_m: float


def _approaches(apart_m: Floats, one: SpanEvidence, rules: Rules) -> Iterator[_Approach]:
    """Yield the stretches in which distances (B,) are much less than usual."""
    limits, bin_m = rules.of("conductors_converging"), one.axis.bin_m
    for known in _smooth_runs(apart_m, limits["max_slope"] * bin_m):
        if len(known) * bin_m < 2 * limits["min_length_m"]:
            continue
        usual_m = float(np.quantile(apart_m[known], _USUAL_QUANTILE))
        limit_m = limits["max_share"] * usual_m
        is_near = (apart_m[known] < limit_m) & (usual_m >= limits["min_usual_m"])
        for run in find_runs(is_near, limits["min_length_m"] / bin_m):
            yield _Approach(known[run], float(apart_m[known[run]].min()), limit_m, usual_m)


def _smooth_runs(apart_m: Floats, max_step_m: float) -> list[Ints]:
    """Split bins at jumps, which occur where a track changes its conductor."""
    known = np.flatnonzero(np.isfinite(apart_m))
    steps = np.diff(known)
    is_jump = (np.abs(np.diff(apart_m[known])) > max_step_m * steps) | (steps > _MAX_UNKNOWN_BINS)
    return np.split(known, np.flatnonzero(is_jump) + 1)


def _to_finding(one: SpanEvidence, found: _Approach, track_id: int, origin: LocalMetres) -> Finding:
    span_id = one.axis.span_id
    what = f"two conductors appear {found.least_m:.1f} m apart in span {span_id}"
    return Finding(
        "conductors_converging",
        one.rows_showing(found.bins),
        f"{what}, elsewhere {found.usual_m:.1f} m",
        found.least_m,
        found.limit_m,
        "m",
        track_id=track_id,
        span_id=span_id,
        place=one.place(found.bins, origin),
    )


def measured_sag(conductors: Sequence[ConductorTrack]) -> list[ConductorTrack]:
    """Return the conductors whose sag is known."""
    return [one for one in conductors if np.isfinite(one.sag_m)]


def find_sag_changes(
    one: SpanEvidence, conductors: Sequence[ConductorTrack], origin: LocalMetres, rules: Rules
) -> Iterator[Finding]:
    """Find the conductor whose sag differs most from the median of the span."""
    limits = rules.of("sag_change")
    measured = measured_sag(conductors)
    if len(measured) < MIN_SAGS:
        return
    usual_m = float(np.median([one.sag_m for one in measured]))
    outlier = max(measured, key=lambda one: abs(one.sag_m - usual_m))
    difference_m = outlier.sag_m - usual_m
    limit_m = limits["min_difference_m"]
    if abs(difference_m) < limit_m or outlier.misfit_m > limits["max_misfit_m"]:
        return
    word = "lower" if difference_m > 0 else "higher"
    share = one.axis.bins_m / one.axis.length_m
    is_visible = np.isin(np.arange(len(share)), outlier.keys % len(share))
    bins = np.flatnonzero((share * (1 - share) > 0.125) & is_visible)
    if len(bins):
        yield Finding(
            "sag_change",
            one.rows_showing(bins),
            f"a conductor hangs {abs(difference_m):.1f} m {word} than the others of span {one.axis.span_id}",
            abs(difference_m),
            limit_m,
            "m",
            track_id=outlier.track,
            span_id=one.axis.span_id,
            place=one.place(bins, origin),
        )


def compared_bins(one: SpanEvidence, conductors: Sequence[ConductorTrack], rules: Rules) -> Mask:
    """Return the bins (B,) within the stretches along which the distance of two conductors is known."""
    n_bins, limits = len(one.axis.centres), rules.of("conductors_converging")
    compared = np.zeros(n_bins, bool)
    for i, first in enumerate(conductors):
        for second in conductors[i + 1 :]:
            apart_m = _distances_m(first, second, n_bins, rules)
            for known in _smooth_runs(apart_m, limits["max_slope"] * one.axis.bin_m):
                if len(known) * one.axis.bin_m >= 2 * limits["min_length_m"]:
                    compared[known[0] : known[-1] + 1] = True
    return compared
