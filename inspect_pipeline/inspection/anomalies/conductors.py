"""Rules about how the conductors of a span hang beside each other.

A lane is a track within a span: where it appears across, bin by bin, and what follows about its sag. A view
from one side cannot tell a conductor that hangs lower from one that hangs farther away: what bends as a
parabola over the whole span is taken for sag, anything else for a change across.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from inspect_pipeline.inspection.anomalies.frames import Finding
from inspect_pipeline.inspection.rows import runs_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from inspect_pipeline.arrays import Floats, Ints, Mask
    from inspect_pipeline.geometry.local_frame import LocalMetres
    from inspect_pipeline.inspection.rules import Rules
    from inspect_pipeline.inspection.span_evidence import SpanEvidence


_MAX_UNKNOWN_BINS = 3
_USUAL_QUANTILE = 0.8  # of the distances of two lanes along the span, as what is usual for them
_RAISED_M = 0.5  # how far conductors of one span hang above or below each other
_NOISE_M = 0.05  # of a crossing
_TURNS = 8
_MIN_DEPTH_M = 1.0
_MISFIT_QUANTILE = 0.8
_MIN_FITTING = 0.85  # of the crossings of a track; else it went over to another conductor amid the span


@dataclass(frozen=True, slots=True, eq=False)
class ConductorTrack:
    """A track in a span.

    sights (C,) are its crossings of bins in frames, as one number in order, across_m (C,) where it appears
    there. sag_m: how low it hangs in the middle, as a parabola, and misfit_m how far it is from one; NaN
    where too little of it is seen, or it is parts of two conductors.
    """

    track: int
    sights: Ints
    across_m: Floats
    sag_m: float
    misfit_m: float


@dataclass(frozen=True, slots=True, eq=False)
class LinesOfSight:
    """Lines of sight (C,): from where along, to the side and above the plane, and metres per metre down."""

    from_m: Floats
    side_m: Floats
    above_m: Floats
    ahead: Floats
    slope: Floats

    def select(self, chosen: Mask) -> LinesOfSight:
        """Some of them."""
        return LinesOfSight(*(getattr(self, name)[chosen] for name in self.__slots__))


def make_lanes(one: SpanEvidence, rules: Rules) -> list[ConductorTrack]:
    """The tracks of a span that are seen at enough places."""
    view, axis = one.view, one.axis
    tracks = one.lines_track[view.line]
    sights = _sights(one)
    lanes = []
    for track in np.unique(tracks).tolist():
        own = tracks == track
        seen_m = len(np.unique(view.bin[own])) * axis.bin_m
        is_enough = seen_m >= rules.of("sag_change")["min_share"] * axis.length_m
        fit = _fit_sag(sights.select(own), axis.length_m) if is_enough else (np.nan, np.nan)
        places, once = np.unique(view.frame[own] * len(axis.middles) + view.bin[own], return_index=True)
        lanes.append(ConductorTrack(track, places, view.across_m[own][once], *fit))
    return lanes


def _distances_m(first: ConductorTrack, second: ConductorTrack, n_bins: int, rules: Rules) -> Floats:
    """(B,) how far two lanes appear from each other in the frames that have both; NaN where too few have."""
    both, i, j = np.intersect1d(first.sights, second.sights, assume_unique=True, return_indices=True)
    return _place_by_bin(np.abs(first.across_m[i] - second.across_m[j]), both % n_bins, n_bins, rules)


def _sights(one: SpanEvidence) -> LinesOfSight:
    """How each crossing of a view was seen."""
    axis, view = one.axis, one.view
    positions = one.cameras.positions[view.frame]
    ground = positions[:, :2] - axis.start
    side_m, above_m = ground @ axis.across, positions[:, 2] - axis.height_m
    from_m = ground @ axis.along
    return LinesOfSight(
        from_m=from_m,
        side_m=side_m,
        above_m=above_m,
        ahead=(axis.bins_m[view.bin] - from_m) / above_m,
        slope=(view.across_m - side_m) / above_m,
    )


def _fit_sag(seen: LinesOfSight, length_m: float) -> tuple[float, float]:
    """How far below its ends a conductor hangs in the middle of its span, and the misfit, in metres.

    A conductor at y, hung e above the plane and sagging by s, is seen at a slope q across per metre down:
    q = (y - side) / (above - e + s p), with p = 4 x (1 - x) at a share x of the span; and x itself follows
    from how far down it is. Gauss-Newton, with e held near 0, leaving out what fits badly.
    """
    y_m = float(np.median(seen.side_m + seen.slope * seen.above_m))
    raised_m = sag_m = 0.0
    fits = np.ones(len(seen.slope), bool)
    depth_m, parabola = seen.above_m, np.zeros(len(fits))
    for _ in range(_TURNS):
        share = np.clip((seen.from_m + seen.ahead * depth_m) / length_m, 0, 1)
        parabola = 4 * share * (1 - share)
        depth_m = seen.above_m - raised_m + sag_m * parabola
        slope = (y_m - seen.side_m) / depth_m
        # In metres across, at the depth of the conductor.
        terms = np.column_stack((np.ones_like(slope), slope, -slope * parabola))[fits]
        wanted = ((seen.slope - slope) * depth_m)[fits]
        weight = np.sqrt(len(wanted)) * _NOISE_M / _RAISED_M
        rows = np.vstack((terms, [0.0, weight, 0.0]))
        step = np.linalg.lstsq(rows, np.append(wanted, -weight * raised_m), rcond=None)[0]
        y_m, raised_m, sag_m = (np.array([y_m, raised_m, sag_m]) + step).tolist()
        depth_m = np.maximum(seen.above_m - raised_m + sag_m * parabola, _MIN_DEPTH_M)
        away = np.abs(seen.slope * depth_m - (y_m - seen.side_m))
        fits = away <= 4 * max(float(np.median(away)), 0.01)
    if fits.mean() < _MIN_FITTING:
        return float("nan"), float("nan")
    return sag_m, float(np.quantile(away, _MISFIT_QUANTILE))


def _place_by_bin(across_m: Floats, bins: Ints, n_bins: int, rules: Rules) -> Floats:
    """(B,) the median of each bin; NaN with too few values, or where a moving view has them differ."""
    medians = np.full(n_bins, np.nan)
    order = np.argsort(bins, kind="stable")
    edges = np.flatnonzero(np.diff(bins[order])) + 1
    for group in np.split(order, edges) if len(order) else ():
        if len(group) < rules.anomalies["min_views"]:
            continue
        low, middle, high = np.quantile(across_m[group], (0.1, 0.5, 0.9))
        if high - low <= rules.of("conductors_converging")["max_spread_m"]:
            medians[bins[group[0]]] = middle
    return medians


def find_converging(
    one: SpanEvidence, lanes: Sequence[ConductorTrack], origin: LocalMetres, rules: Rules
) -> Iterator[Finding]:
    """The two conductors that come much closer than they are along most of the span, and lose most."""
    found = [
        _to_finding(one, approach, first.track, origin)
        for i, first in enumerate(lanes)
        for second in lanes[i + 1 :]
        for approach in _approaches(_distances_m(first, second, len(one.axis.middles), rules), one, rules)
    ]
    # One that moves towards its neighbour comes nearer to others behind it too.
    if found:
        yield max(found, key=lambda one: one.threshold - one.value)


class _Approach(NamedTuple):
    """Bins in which two lanes are nearer than a limit, how near, and what is usual for them."""

    bins: Ints
    least_m: float
    limit_m: float
    usual_m: float


def _approaches(apart_m: Floats, one: SpanEvidence, rules: Rules) -> Iterator[_Approach]:
    """Where distances (B,) are much less than usual."""
    limits, bin_m = rules.of("conductors_converging"), one.axis.bin_m
    for known in _smooth_stretches(apart_m, limits["max_slope"] * bin_m):
        if len(known) * bin_m < 2 * limits["min_length_m"]:
            continue
        usual_m = float(np.quantile(apart_m[known], _USUAL_QUANTILE))
        limit_m = limits["max_share"] * usual_m
        is_near = (apart_m[known] < limit_m) & (usual_m >= limits["min_usual_m"])
        for run in runs_of(is_near, limits["min_length_m"] / bin_m):
            yield _Approach(known[run], float(apart_m[known[run]].min()), limit_m, usual_m)


def _smooth_stretches(apart_m: Floats, max_step_m: float) -> list[Ints]:
    """Bins without a jump between them: where a track goes over to another conductor, there is one."""
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


def find_sag_changes(
    one: SpanEvidence, lanes: Sequence[ConductorTrack], origin: LocalMetres, rules: Rules
) -> Iterator[Finding]:
    """A conductor that hangs lower, or higher, than the median of the others; the oddest of a span."""
    limits = rules.of("sag_change")
    measured = [lane for lane in lanes if np.isfinite(lane.sag_m)]
    if len(measured) < 3:
        return
    usual_m = float(np.median([lane.sag_m for lane in measured]))
    oddest = max(measured, key=lambda lane: abs(lane.sag_m - usual_m))
    difference_m = oddest.sag_m - usual_m
    limit_m = limits["min_difference_m"]
    if abs(difference_m) < limit_m or oddest.misfit_m > limits["max_misfit_m"]:
        return
    word = "lower" if difference_m > 0 else "higher"
    share = one.axis.bins_m / one.axis.length_m
    is_seen = np.isin(np.arange(len(share)), oddest.sights % len(share))
    bins = np.flatnonzero((share * (1 - share) > 0.125) & is_seen)
    if len(bins):
        yield Finding(
            "sag_change",
            one.rows_showing(bins),
            f"a conductor hangs {abs(difference_m):.1f} m {word} than the others of span {one.axis.span_id}",
            abs(difference_m),
            limit_m,
            "m",
            track_id=oddest.track,
            span_id=one.axis.span_id,
            place=one.place(bins, origin),
        )
