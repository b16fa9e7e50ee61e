"""The conductors of a span as their lines show them, and the rule about distances between them.

A view from one side hardly distinguishes a conductor that hangs lower from one that is farther away. A
parabola over the whole span is taken as sag (see `sags`), any other shape as a change across.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from inspect_pipeline.inspection.anomalies.frames import Finding
from inspect_pipeline.inspection.conductors.fit import fit_conductor
from inspect_pipeline.inspection.rows import find_runs

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from inspect_pipeline.arrays import Floats, Ints
    from inspect_pipeline.geometry.local_frame import LocalMetres
    from inspect_pipeline.inspection.conductors.fit import ConductorFit
    from inspect_pipeline.inspection.rules import Rules
    from inspect_pipeline.inspection.span_evidence import SpanEvidence


_MAX_UNKNOWN_BINS = 3
_USUAL_QUANTILE = 0.8  # of the distances of two conductors along the span, taken as usual
_MIN_COMPARED = 0.4  # of the span, along which the distance of two conductors must be known
_BUNDLE_M = 0.8  # between wires of a bundle, at most
_MOST_USUAL = 1.25  # times their distance on all spans: one may have moved away in the rest
_LEAST_VIEWS = 2  # fewer than min_views count where they agree
_FEW_AGREE = 0.25  # of max_spread_m, within which they do
_MIN_APART, _MIN_APART_SD = 2.0, 4.0  # times aligned_px, or the noise: nearer conductors are not compared
_MIN_ASIDE = 0.5  # of the distance of two conductors, as it appears: else one is nearly behind the other
_NOISY_USUAL = 1.5  # times min_usual_m: under noise, wires of a bundle appear farther apart than they are
_MIN_SAG_SHOWN, _MIN_JUDGED = 0.7, 0.5  # of the sag, in the part in view; of that part in metres


@dataclass(frozen=True, slots=True, eq=False)
class SpanConductor:
    """A conductor of a span as its lines show it.

    number: of its place. track: of most of its lines. keys (C,): frame * B + bin of its crossings, ascending.
    across_m (C,): where it crosses. fit: None where too little of it is visible, or its lines are of several.
    """

    number: int
    track: int
    keys: Ints
    across_m: Floats
    fit: ConductorFit | None


def measure_conductors(one: SpanEvidence, rules: Rules) -> list[SpanConductor]:
    """Return the conductors of a span that have lines, with fits of those visible along enough of it."""
    sight, axis = one.sight, one.axis
    view = sight.view
    if one.votes is None:
        return []
    owner = one.votes.owner[view.line]
    fine = sight.fine[view.frame, view.bin]
    conductors = []
    for number, place in enumerate(one.places):
        own = np.flatnonzero((owner == number) & fine)
        if not len(own):
            continue
        fit = (
            fit_conductor(sight, own, place)
            if _shows_sag(one, number, np.unique(view.bin[own]), rules)
            else None
        )
        keys, once = np.unique(view.frame[own] * len(axis.centres) + view.bin[own], return_index=True)
        tracks, counts = np.unique(sight.lines.track[view.line[own]], return_counts=True)
        track = int(tracks[np.argmax(counts)])
        conductors.append(SpanConductor(number, track, keys, view.across_m[own][once], fit))
    return conductors


def _shows_sag(one: SpanEvidence, number: int, bins: Ints, rules: Rules) -> bool:
    """Return whether a conductor is visible and judged along enough of a span, and from low to high on it.

    A structure at an unknown height makes a sag of its own.
    """
    if not one.axis.is_ground_known:
        return False
    parabola, least_m = one.sight.parabola[bins], rules.of("sag_change")["min_share"] * one.axis.length_m
    is_visible = len(bins) * one.axis.bin_m >= least_m and np.ptp(parabola) >= _MIN_SAG_SHOWN
    return bool(is_visible and one.is_judged[number, bins].mean() >= _MIN_JUDGED)


def _distances_m(first: SpanConductor, second: SpanConductor, one: SpanEvidence, rules: Rules) -> Floats:
    """Return distances (B,) over the frames with both conductors, NaN where too few have.

    Distances in the image are compared with those expected of the places of both: they are seen from aside.
    """
    n_bins = len(one.axis.centres)
    both, i, j = np.intersect1d(first.keys, second.keys, assume_unique=True, return_indices=True)
    frame, bins = np.divmod(both, n_bins)
    places = one.places[first.number], one.places[second.number]
    appear = [one.sight.appear_at(each.across_m, each.raised_m, each.sag_m)[frame, bins] for each in places]
    expected_m = np.abs(appear[0] - appear[1])
    scale_px = one.sight.scale_px[frame, bins]
    real_m = _places_apart_m(first.number, second.number, one)
    least_px = np.maximum(rules.anomalies["aligned_px"], _MIN_APART_SD * one.sight.noise_m * scale_px)
    apart = (expected_m * scale_px >= _MIN_APART * least_px) & (expected_m >= _MIN_ASIDE * real_m)
    ratio = np.abs(first.across_m[i] - second.across_m[j])[apart] / expected_m[apart]
    return _median_by_bin(real_m * ratio, bins[apart], n_bins, rules)


def _places_apart_m(first: int, second: int, one: SpanEvidence) -> float:
    """Return the distance of two conductors as they hang on all spans."""
    a, b = one.places[first], one.places[second]
    return float(np.hypot(a.across_m - b.across_m, a.raised_m - b.raised_m))


def _median_by_bin(across_m: Floats, bins: Ints, n_bins: int, rules: Rules) -> Floats:
    """Return the median of each bin (B,), NaN with too few values or where views disagree."""
    medians = np.full(n_bins, np.nan)
    order = np.argsort(bins, kind="stable")
    edges = np.flatnonzero(np.diff(bins[order])) + 1
    for group in np.split(order, edges) if len(order) else ():
        if len(group) < _LEAST_VIEWS:
            continue
        low, middle, high = np.quantile(across_m[group], (0.1, 0.5, 0.9))
        limits = rules.of("conductors_converging")
        is_few = len(group) < limits["min_views"]
        if high - low <= limits["max_spread_m"] * (_FEW_AGREE if is_few else 1.0):
            medians[bins[group[0]]] = middle
    return medians


def find_converging(
    one: SpanEvidence, conductors: Sequence[SpanConductor], origin: LocalMetres, rules: Rules
) -> Iterator[Finding]:
    """Find the two conductors that come closest relative to their usual distance."""
    told_apart = [each for each in conductors if _is_judged(one, each)]
    found = [
        _to_finding(one, approach, (first, second), origin)
        for i, first in enumerate(told_apart)
        for second in told_apart[i + 1 :]
        for approach in _approaches(first, second, one, rules)
    ]
    # A conductor that moves towards its neighbour also approaches those behind it.
    if found:
        yield max(found, key=lambda one: one.threshold - one.value)


def _is_judged(one: SpanEvidence, conductor: SpanConductor) -> bool:
    """Return whether a conductor is judged along most of where lines of it are.

    With errors of poses, the wires of a bundle are mixed up here and there.
    """
    apart_m = [
        _places_apart_m(conductor.number, k, one) for k in range(len(one.places)) if k != conductor.number
    ]
    if not one.sight.is_exact and min(apart_m, default=np.inf) < _BUNDLE_M:
        return False
    bins = np.unique(conductor.keys % len(one.axis.centres))
    return bool(one.is_judged[conductor.number, bins].mean() >= _MIN_JUDGED)


class _Approach(NamedTuple):
    """Bins in which two conductors are closer than a limit, their least and their usual distance."""

    bins: Ints
    least_m: float
    limit_m: float
    usual_m: float


def _approaches(
    first: SpanConductor, second: SpanConductor, one: SpanEvidence, rules: Rules
) -> Iterator[_Approach]:
    """Yield the stretches in which two conductors are much closer than usual."""
    limits, bin_m = rules.of("conductors_converging"), one.axis.bin_m
    apart_m = _distances_m(first, second, one, rules)
    most_m = _MOST_USUAL * _places_apart_m(first.number, second.number, one)
    for known in _smooth_runs(apart_m, limits["max_slope"] * bin_m):
        if len(known) < one.axis.n_bins(2 * limits["min_length_m"]):
            continue
        usual_m = min(float(np.quantile(apart_m[known], _USUAL_QUANTILE)), most_m)
        limit_m = limits["max_share"] * usual_m
        least_m = limits["min_usual_m"] * (1.0 if one.sight.is_exact else _NOISY_USUAL)
        is_near = (apart_m[known] < limit_m) & (usual_m >= least_m)
        for run in find_runs(is_near, one.axis.n_bins(limits["min_length_m"])):
            yield _Approach(known[run], float(apart_m[known[run]].min()), limit_m, usual_m)


def _smooth_runs(apart_m: Floats, max_step_m: float) -> list[Ints]:
    """Split bins at jumps, which occur where a track changes its conductor."""
    known = np.flatnonzero(np.isfinite(apart_m))
    steps = np.diff(known)
    is_jump = (np.abs(np.diff(apart_m[known])) > max_step_m * steps) | (steps > _MAX_UNKNOWN_BINS)
    return np.split(known, np.flatnonzero(is_jump) + 1)


def _to_finding(
    one: SpanEvidence, found: _Approach, pair: tuple[SpanConductor, SpanConductor], origin: LocalMetres
) -> Finding:
    span_id = one.axis.span_id
    what = f"two conductors appear {found.least_m:.1f} m apart in span {span_id}"
    return Finding(
        "conductors_converging",
        one.rows_showing(found.bins, [one.places[each.number] for each in pair]),
        f"{what}, elsewhere {found.usual_m:.1f} m",
        found.least_m,
        found.limit_m,
        "m",
        track_id=pair[0].track,
        span_id=span_id,
        place=one.place(found.bins, origin),
        conductors=(pair[0].number, pair[1].number),
    )


def compared_share(one: SpanEvidence, conductors: Sequence[SpanConductor], rules: Rules) -> Floats:
    """Return the share (B,) of neighbouring conductors whose distance is known along a stretch.

    In a shorter one, they may be near each other all along: nobody knows what is usual.
    """
    n_bins, limits = len(one.axis.centres), rules.of("conductors_converging")
    least_m = max(2 * limits["min_length_m"], _MIN_COMPARED * one.axis.length_m)
    compared = np.zeros(n_bins)
    for first, second in pairwise(each for each in conductors if _is_judged(one, each)):
        apart_m = _distances_m(first, second, one, rules)
        for known in _smooth_runs(apart_m, limits["max_slope"] * one.axis.bin_m):
            if len(known) >= one.axis.n_bins(least_m):
                compared[known[0] : known[-1] + 1] += 1
    return compared / max(len(one.places) - 1, 1)
