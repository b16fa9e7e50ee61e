"""Rules about the conductors that a span has: missing ones, ones that end, gaps, and too many."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from inspect_pipeline.inspection.anomalies.frames import Finding
from inspect_pipeline.inspection.anomalies.hidden import hides_none
from inspect_pipeline.inspection.rows import find_runs
from inspect_pipeline.inspection.span_evidence import ABSENT, PRESENT, UNKNOWN

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from inspect_pipeline.arrays import Ints, Mask
    from inspect_pipeline.geometry.local_frame import LocalMetres
    from inspect_pipeline.inspection.conductors.layout import Place
    from inspect_pipeline.inspection.rules import Rules
    from inspect_pipeline.inspection.span_evidence import SpanEvidence


_TRACK_START_FRAMES = 5  # until all lines of a new view have their tracks
_MIN_END_SEEN = 0.5  # of the weight of a good view
_MIN_PRESENT_SHARE = 0.3  # of what is known of a conductor, from which on a span has it


def usual_count(evidence: Sequence[SpanEvidence], rules: Rules) -> int:
    """Return the most frequent number of conductors of the spans of a flight, 0 when none is known."""
    numbers = [int(_has_conductors(one, rules).sum()) for one in evidence]
    known = [number for number in numbers if number]
    return max(sorted(set(known), reverse=True), key=known.count, default=0)


def _has_conductors(one: SpanEvidence, rules: Rules) -> Mask:
    """Return which conductors (K,) a span has, whole or in part."""
    inner = one.states[:, inner_bins(one, rules)]
    known = np.maximum((inner != UNKNOWN).sum(axis=1), 1)
    return np.asarray((inner == PRESENT).sum(axis=1) >= _MIN_PRESENT_SHARE * known)


def inner_bins(one: SpanEvidence, rules: Rules) -> Mask:
    """Return the bins (B,) that are not next to a structure."""
    along_m, margin_m = one.axis.bins_m, rules.anomalies["margin_m"]
    inner: Mask = (along_m >= margin_m) & (along_m <= one.axis.length_m - margin_m)
    return inner


def missing_conductors(one: SpanEvidence, rules: Rules) -> Ints:
    """Return the conductors that other spans of the flight have and this one lacks nearly all along."""
    limits, inner = rules.of("conductor_count"), inner_bins(one, rules)
    states = one.states[:, inner]
    n_known, n_absent = (states != UNKNOWN).sum(axis=1), (states == ABSENT).sum(axis=1)
    is_long = n_known * one.axis.bin_m >= limits["min_length_m"]
    return np.flatnonzero(is_long & (n_absent >= limits["min_share"] * n_known))


def doubt_rare(evidence: Sequence[SpanEvidence], rules: Rules) -> list[SpanEvidence]:
    """Return the evidence without what it says of conductors that more spans lack than have.

    Such a place is more likely a mistake than a conductor.
    """
    missing = Counter(number for one in evidence for number in missing_conductors(one, rules).tolist())
    present = Counter(
        number for one in evidence for number in np.flatnonzero(_has_conductors(one, rules)).tolist()
    )
    rare = [number for number in missing if missing[number] > present[number]]
    doubted = []
    for one in evidence:
        states = one.states.copy()
        states[[number for number in rare if number < len(states)]] = UNKNOWN
        doubted.append(replace(one, states=states))
    return doubted


def find_count_changes(
    one: SpanEvidence, expected: int, origin: LocalMetres, rules: Rules
) -> Iterator[Finding]:
    """Find missing conductors, further ones, and those that end or are interrupted within the span."""
    missing = missing_conductors(one, rules)
    n_left = _count_places(one, expected) - len(missing)
    known = np.flatnonzero(inner_bins(one, rules) & one.is_judged.any(axis=0))
    if len(missing) and n_left < expected:
        bins = np.flatnonzero((one.states[missing] == ABSENT).any(axis=0))
        yield _count_finding(one, bins, (n_left, expected), origin, [one.places[k] for k in missing])
    elif not len(missing) and n_left < expected and len(known) and hides_none(one, rules):
        yield _count_finding(one, known, (n_left, expected), origin)
    elif len(known):
        n_present = one.is_present[:, known].sum(axis=0)
        is_more = n_present > expected
        limits = rules.of("conductor_count")
        if is_more.mean() >= limits["min_share"] and is_more.sum() * one.axis.bin_m >= limits["min_length_m"]:
            level = int(np.median(n_present[is_more]))
            yield _count_finding(one, known[is_more], (level, expected), origin)
    for number in np.setdiff1d(np.arange(len(one.places)), missing).tolist():
        yield from _find_deficits(one, number, expected, origin, rules)


def _count_places(one: SpanEvidence, expected: int) -> int:
    """Return how many conductors the places of a span are of.

    One more than expected is of wires that frames mix up, if there are such. Still more are not understood.
    """
    n_places, n_unknown = len(one.places), int((~one.is_judged.any(axis=1)).sum())
    return expected if n_places == expected + 1 and n_unknown > 1 else n_places


def _find_deficits(
    one: SpanEvidence, number: int, expected: int, origin: LocalMetres, rules: Rules
) -> Iterator[Finding]:
    """Find where a conductor ends within the span (lost) or is interrupted (gap)."""
    bin_m, span_id, states = one.axis.bin_m, one.axis.span_id, one.states[number]
    known = np.flatnonzero(inner_bins(one, rules) & (states != UNKNOWN))
    at_most = _count_places(one, expected) - (one.states == ABSENT).sum(axis=0)
    lacking = (states[known] == ABSENT) & (at_most[known] < expected)
    for run in find_runs(_close_gaps(lacking, rules.anomalies["bridged_m"] / bin_m), 1):
        bins, length_m = known[run], len(run) * bin_m
        is_at_end = run[0] == 0 or run[-1] == len(known) - 1
        if _times_seen_ending(one, number, bins) < _MIN_END_SEEN:
            continue
        if is_at_end and not _is_end_certain(one, number, bins, rules):
            continue
        kind = "conductor_lost" if is_at_end else "conductor_gap"
        limit_m = rules.of(kind)["min_length_m"] + one.sight.widened_bins * bin_m
        if length_m < limit_m:
            continue
        start_m = one.axis.bins_m[bins[0]] - bin_m / 2
        level = int(np.median(at_most[bins]))
        if is_at_end:
            edge_m = start_m if run[0] > 0 else one.axis.bins_m[bins[-1]] + bin_m / 2
            reason = f"{level} of {expected} conductors beyond {edge_m:.0f} m of span {span_id}"
        else:
            where = f"{start_m:.0f} m of span {span_id}"
            reason = f"{level} of {expected} conductors for {length_m:.1f} m from {where}"
        rows, place = (
            one.rows_showing(_whole(one, bins, known), [one.places[number]]),
            one.place(bins, origin),
        )
        yield Finding(
            kind, rows, reason, length_m, limit_m, "m", span_id=span_id, place=place, conductors=(number,)
        )


def _whole(one: SpanEvidence, bins: Ints, known: Ints) -> Ints:
    """Return the first and last bin of what is missing: up to the structure if no more is known."""
    first = 0 if bins[0] == known[0] else bins[0]
    last = len(one.axis.centres) - 1 if bins[-1] == known[-1] else bins[-1]
    return np.array([first, last])


def _times_seen_ending(one: SpanEvidence, number: int, bins: Ints) -> float:
    """Return the weight of frames that show that a conductor is absent there, and a line of it elsewhere.

    Other frames may all have missed its line.
    """
    if one.votes is None:
        return 0.0
    in_frame = one.votes.in_frame[:, number]
    return float(one.votes.against[in_frame, number][:, bins].sum(axis=0).max(initial=0.0))


def _close_gaps(mask: Mask, longest: float) -> Mask:
    """Fill short runs of False between two runs of True."""
    closed = mask.copy()
    for run in find_runs(~mask, 1):
        if run[0] > 0 and run[-1] < len(mask) - 1 and len(run) <= longest:
            closed[run] = True
    return closed


def _is_end_certain(one: SpanEvidence, number: int, bins: Ints, rules: Rules) -> bool:
    """Return whether bins reach a structure, or lines had their tracks when the bins came into view.

    Where a flight starts within a span, lines without a track yet look like missing ones. There frames must
    show where it ends.
    """
    along_m, near_m = one.axis.bins_m[bins], 2 * rules.anomalies["margin_m"]
    if along_m[0] <= near_m or along_m[-1] >= one.axis.length_m - near_m:
        return True
    if one.votes is None:
        return False
    weight = one.votes.weight[:, number]
    first, first_here = (np.flatnonzero(mask.any(axis=1))[0] for mask in (weight, weight[:, bins]))
    is_late = first_here - first >= _TRACK_START_FRAMES
    return bool(is_late or _times_seen_ending(one, number, bins) >= rules.anomalies["min_support"])


def _count_finding(
    one: SpanEvidence,
    bins: Ints,
    numbers: tuple[int, int],
    origin: LocalMetres,
    missing: Sequence[Place] = (),
) -> Finding:
    """Return the finding of a span with another number of conductors than expected; numbers: both."""
    level, expected = numbers
    span_id = one.axis.span_id
    reason = f"{level} conductors along span {span_id}, where {expected} are expected"
    # What is missing is missing all along, also where it was not judged.
    rows = one.rows_showing(np.arange(len(one.axis.centres)), missing)
    place = one.place(bins, origin)
    return Finding(
        "conductor_count", rows, reason, level, expected, "conductors", span_id=span_id, place=place
    )
