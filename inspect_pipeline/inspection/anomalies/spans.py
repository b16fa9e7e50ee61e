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
_MIN_AGREEING = 0.75  # of the bins that a frame votes on: with what all frames say
_MIN_FOUND = 0.5  # of the weight of frames at the end of a stretch
_OFTEN = 2.0  # times min_support: of a gap that errors of positions hardly make
_LONG = 2.0  # times the least length: ends of a shorter stretch must be seen in more frames
_MIN_END_SEEN = 0.5  # of the weight of a good view, with exact poses; else min_support
_MAX_ALL_SEEN = 0.2  # of what frames show without a conductor: with all lines, one of them a false one
_FEW_LINES, _MOSTLY_ABSENT = 0.1, 0.5  # of those; of what is known of a conductor without lines
_MAX_WITH_LINE = 0.3  # of the frames with a line of other conductors: those with one of a missing one
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
    absent = np.setdiff1d(_absent(one, rules), _in_frames(one, _MAX_WITH_LINE))
    return absent[[not _is_seen_ending(one, number, rules) for number in absent.tolist()]]


def _is_seen_ending(one: SpanEvidence, number: int, rules: Rules) -> bool:
    """Return whether a conductor is present somewhere, and frames show where it ends."""
    states = np.where(inner_bins(one, rules), one.states[number], UNKNOWN)
    seen = _times_seen_ending(one, number, np.flatnonzero(states == ABSENT))
    return bool(np.any(states == PRESENT)) and seen >= rules.anomalies["min_support"]


def _absent(one: SpanEvidence, rules: Rules) -> Ints:
    """Return the conductors that are absent nearly wherever it is known of them.

    Or in most of it, if hardly any frame has a line of it: it may be another line that is present.
    """
    limits, inner = rules.of("conductor_count"), inner_bins(one, rules)
    states = one.states[:, inner]
    n_known, n_absent = (states != UNKNOWN).sum(axis=1), (states == ABSENT).sum(axis=1)
    is_long = n_known >= one.axis.n_bins(limits["min_length_m"])
    min_share = np.full(len(states), limits["min_share"])
    min_share[np.setdiff1d(np.arange(len(states)), _in_frames(one, _FEW_LINES))] = _MOSTLY_ABSENT
    return np.flatnonzero(is_long & (n_absent >= min_share * n_known))


def _in_frames(one: SpanEvidence, least_share: float) -> Ints:
    """Return the conductors of which enough frames have a line, compared with the others of the span."""
    if one.votes is None:
        return np.zeros(0, np.int64)
    n_frames = one.votes.in_frame.sum(axis=0)
    return np.flatnonzero(n_frames > least_share * np.median(n_frames))


def doubt_rare(evidence: Sequence[SpanEvidence], rules: Rules) -> list[SpanEvidence]:
    """Return the evidence without what it says of conductors that more spans lack than have.

    Such a place is more likely a mistake than a conductor. So is one that a span lacks where it is known of,
    while many of its frames have a line of it: that is elsewhere than thought.
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
        states[np.intersect1d(_absent(one, rules), _in_frames(one, _MAX_WITH_LINE))] = UNKNOWN
        doubted.append(replace(one, states=states))
    return doubted


def find_count_changes(
    one: SpanEvidence, expected: int, origin: LocalMetres, rules: Rules
) -> Iterator[Finding]:
    """Find missing conductors, further ones, and those that end or are interrupted within the span."""
    missing = missing_conductors(one, rules)
    missing = missing[[not _are_all_seen(one, number, expected) for number in missing.tolist()]]
    n_left = count_places(one, expected) - len(missing)
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
        is_long = is_more.sum() >= one.axis.n_bins(limits["min_length_m"])
        if is_long and is_more.mean() >= limits["min_share"]:
            level = int(np.median(n_present[is_more]))
            yield _count_finding(one, known[is_more], (level, expected), origin)
    for number in np.setdiff1d(np.arange(len(one.places)), missing).tolist():
        yield from _find_deficits(one, number, expected, origin, rules)


def _are_all_seen(one: SpanEvidence, number: int, expected: int) -> bool:
    """Return whether frames often have as many lines as expected where one conductor is absent."""
    if one.votes is None:
        return False
    view, lacks = one.sight.view, one.votes.against[:, number] > 0
    n_lines = np.zeros(lacks.shape, np.int64)
    np.add.at(n_lines, (view.frame, view.bin), 1)
    return bool(lacks.any() and np.mean(n_lines[lacks] >= expected) > _MAX_ALL_SEEN)


def count_places(one: SpanEvidence, expected: int) -> int:
    """Return how many conductors the places of a span are of, as far as that is understood.

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
    if not np.any(states[known] == PRESENT):
        return  # it ends nowhere
    at_most = count_places(one, expected) - (one.states == ABSENT).sum(axis=0)
    lacking = (states[known] == ABSENT) & (at_most[known] < expected)
    for run in find_runs(_close_gaps(lacking, rules.anomalies["bridged_m"] / bin_m), 1):
        bins, length_m = known[run], len(run) * bin_m
        is_at_end = bool(run[0] == 0 or run[-1] == len(known) - 1) and not _goes_on(one, number, bins, rules)
        seen = _times_seen_ending(one, number, bins)
        if seen < (rules.anomalies["min_support"] if one.sight.widened_bins else _MIN_END_SEEN):
            continue
        if is_at_end and not _is_end_certain(one, number, bins, rules):
            continue
        kind = "conductor_lost" if is_at_end else "conductor_gap"
        limit_m = rules.of(kind)["min_length_m"]
        if seen < _OFTEN * rules.anomalies["min_support"]:
            limit_m += one.sight.widened_bins * bin_m  # less of what many frames show is due to errors
        if len(run) < one.axis.n_bins(limit_m):
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


def _goes_on(one: SpanEvidence, number: int, bins: Ints, rules: Rules) -> bool:
    """Return whether some frames have a conductor on both sides of a stretch, if not enough to be sure.

    Errors of positions may widen a gap up to the end of the view: most frames have a line there all the same.
    """
    if one.votes is None:
        return False
    in_favour = (one.votes.weight - one.votes.against)[:, number].sum(axis=0)
    is_seen = inner_bins(one, rules) & (in_favour >= rules.anomalies["min_support"])
    is_seen |= one.is_present[number]  # up to the structure
    is_found = one.votes.found[number, bins[[0, -1]]] >= _MIN_FOUND
    return bool((is_seen[: bins[0]].any() or is_found[0]) and (is_seen[bins[-1] + 1 :].any() or is_found[1]))


def _whole(one: SpanEvidence, bins: Ints, known: Ints) -> Ints:
    """Return the first and last bin of what is missing: up to the structure if no more is known."""
    first = 0 if bins[0] == known[0] else bins[0]
    last = len(one.axis.centres) - 1 if bins[-1] == known[-1] else bins[-1]
    return np.array([first, last])


def _times_seen_ending(one: SpanEvidence, number: int, bins: Ints) -> float:
    """Return the weight of frames that show that a conductor is absent there, and a line of it elsewhere.

    Other frames may all have missed its line. Those that lack it where most have it may have a false one.
    """
    if one.votes is None:
        return 0.0
    in_frame = one.votes.in_frame[:, number]
    weight, against = one.votes.weight[in_frame, number], one.votes.against[in_frame, number]
    counts = (weight > 0) & (one.states[number] != UNKNOWN)
    agrees = counts & ((against > 0) == (one.states[number] == ABSENT))
    is_sound = agrees.sum(axis=1) >= _MIN_AGREEING * counts.sum(axis=1)
    return float(against[is_sound][:, bins].sum(axis=0).max(initial=0.0))


def _close_gaps(mask: Mask, longest: float) -> Mask:
    """Fill short runs of False between two runs of True."""
    closed = mask.copy()
    for run in find_runs(~mask, 1):
        if run[0] > 0 and run[-1] < len(mask) - 1 and len(run) <= longest:
            closed[run] = True
    return closed


def _is_end_certain(one: SpanEvidence, number: int, bins: Ints, rules: Rules) -> bool:
    """Return whether frames show where a conductor ends while others go on, or for long what is beyond.

    A long stretch is one that reaches a structure, or had lines with tracks when it came into view. Where a
    flight starts within a span, lines without a track yet look like missing ones.
    """
    is_seen = _times_seen_ending(one, number, bins) >= rules.anomalies["min_support"]
    if len(bins) < one.axis.n_bins(_LONG * rules.of("conductor_lost")["min_length_m"]):
        return is_seen and bool(one.is_present[:, bins].any(axis=0).all())
    if is_seen:
        return True
    along_m, near_m = one.axis.bins_m[bins], 2 * rules.anomalies["margin_m"]
    if along_m[0] <= near_m or along_m[-1] >= one.axis.length_m - near_m:
        return True
    if one.votes is None:
        return False
    weight = one.votes.weight[:, number]
    first, first_here = (np.flatnonzero(mask.any(axis=1))[0] for mask in (weight, weight[:, bins]))
    return bool(first_here - first >= _TRACK_START_FRAMES)


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
