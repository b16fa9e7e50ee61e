"""Rules about the number of conductors of a span, bin by bin over all frames that show it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from inspect_pipeline.inspection.anomalies.frames import Finding
from inspect_pipeline.inspection.rows import find_runs

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from inspect_pipeline.arrays import Floats, Ints, Mask
    from inspect_pipeline.geometry.local_frame import LocalMetres
    from inspect_pipeline.inspection.rules import Rules
    from inspect_pipeline.inspection.span_evidence import SpanEvidence


_TRACK_START_FRAMES = 5  # until all lines of a new view have their tracks


def usual_count(levels: Sequence[Floats]) -> int:
    """Return the most frequent number of conductors over all bins of a flight, 0 when none is known."""
    known = np.concatenate([level[np.isfinite(level)] for level in levels]) if levels else np.zeros(0)
    known = known[known > 0].astype(np.int64)
    return int(np.bincount(known).argmax()) if len(known) else 0


def find_count_changes(
    one: SpanEvidence, expected: int, origin: LocalMetres, rules: Rules
) -> Iterator[Finding]:
    """Find stretches of a span with fewer or more conductors than expected."""
    known = np.flatnonzero(inner_bins(one, rules) & np.isfinite(one.level))
    if not len(known):
        return
    limits, bin_m = rules.of("conductor_count"), one.axis.bin_m
    bridged = rules.anomalies["bridged_m"] / bin_m
    for mask in (_close_gaps(one.level[known] < expected, bridged), one.level[known] > expected):
        is_long = mask.sum() * bin_m >= limits["min_length_m"]
        if (
            is_long
            and mask.mean() >= limits["min_share"]
            and _is_supported(one, known[mask], expected, rules)
        ):
            yield _count_finding(one, known[mask], expected, origin)
            return
    yield from _find_deficits(one, known, expected, origin, rules)


def inner_bins(one: SpanEvidence, rules: Rules) -> Mask:
    """Return the bins (B,) that are not next to a structure."""
    along_m, margin_m = one.axis.bins_m, rules.anomalies["margin_m"]
    inner: Mask = (along_m >= margin_m) & (along_m <= one.axis.length_m - margin_m)
    return inner


def _find_deficits(
    one: SpanEvidence, known: Ints, expected: int, origin: LocalMetres, rules: Rules
) -> Iterator[Finding]:
    """Find conductors that end within the span (lost) or are interrupted (gap)."""
    bin_m, span_id = one.axis.bin_m, one.axis.span_id
    lacking = _close_gaps(one.level[known] < expected, rules.anomalies["bridged_m"] / bin_m)
    for run in find_runs(lacking, 1):
        bins, length_m = known[run], len(run) * bin_m
        is_at_end = run[0] == 0 or run[-1] == len(known) - 1
        if is_at_end and not _is_end_certain(one, bins, rules):
            continue
        kind = "conductor_lost" if is_at_end else "conductor_gap"
        limit_m = rules.of(kind)["min_length_m"]
        if length_m < limit_m or not _is_supported(one, bins, expected, rules):
            continue
        start_m = one.axis.bins_m[bins[0]] - bin_m / 2
        level = int(np.median(one.level[bins]))
        if is_at_end:
            edge_m = start_m if run[0] > 0 else one.axis.bins_m[bins[-1]] + bin_m / 2
            reason = f"{level} of {expected} conductors beyond {edge_m:.0f} m of span {span_id}"
        else:
            where = f"{start_m:.0f} m of span {span_id}"
            reason = f"{level} of {expected} conductors for {length_m:.1f} m from {where}"
        rows, place = one.rows_showing(bins), one.place(bins, origin)
        yield Finding(kind, rows, reason, length_m, limit_m, "m", span_id=span_id, place=place)


def _close_gaps(mask: Mask, longest: float) -> Mask:
    """Fill short runs of False between two runs of True."""
    closed = mask.copy()
    for run in find_runs(~mask, 1):
        if run[0] > 0 and run[-1] < len(mask) - 1 and len(run) <= longest:
            closed[run] = True
    return closed


def _is_supported(one: SpanEvidence, bins: Ints, expected: int, rules: Rules) -> bool:
    """Return whether enough frames agree that some bins do not have the expected number."""
    counts, weights = one.counts[:, bins], one.weights[:, bins]
    total = weights.sum(axis=1)
    rows = total >= max(total.max() / 2, 1e-9)
    # Each frame has one vote, whatever the number of bins: the bins of a frame are not independent.
    differing = np.where(np.isfinite(counts), counts != expected, False) * weights
    share = differing[rows].sum(axis=1) / total[rows]
    weight = total[rows] / np.isfinite(counts[rows]).sum(axis=1)
    support, against = float((weight * share).sum()), float((weight * (1 - share)).sum())
    limits = rules.anomalies
    return bool(support >= max(limits["min_support"], limits["min_agreement"] * (support + against)))


def _is_end_certain(one: SpanEvidence, bins: Ints, rules: Rules) -> bool:
    """Return whether bins reach a structure, or lines had their tracks when the bins came into view.

    Where a flight starts within a span, lines without a track yet look like missing ones. There the evidence
    must be twice as strong.
    """
    along_m, near_m = one.axis.bins_m[bins], 2 * rules.anomalies["margin_m"]
    if along_m[0] <= near_m or along_m[-1] >= one.axis.length_m - near_m:
        return True
    shown = np.isfinite(one.counts)
    first, first_here = (np.flatnonzero(mask.any(axis=1))[0] for mask in (shown, shown[:, bins]))
    evidence = float(one.weights[:, bins].sum(axis=0).max())
    return bool(first_here - first >= _TRACK_START_FRAMES or evidence >= 2 * _TRACK_START_FRAMES)


def _count_finding(one: SpanEvidence, bins: Ints, expected: int, origin: LocalMetres) -> Finding:
    level, span_id = int(np.median(one.level[bins])), one.axis.span_id
    reason = f"{level} conductors along span {span_id}, where {expected} are expected"
    rows, place = one.rows_showing(bins), one.place(bins, origin)
    return Finding(
        "conductor_count", rows, reason, level, expected, "conductors", span_id=span_id, place=place
    )
