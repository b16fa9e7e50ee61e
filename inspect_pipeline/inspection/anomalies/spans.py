"""Rules about the conductors of a span, which is looked at bin by bin, over all frames that show it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from inspect_pipeline.inspection.anomalies.conductors import find_converging, find_sag_changes, make_lanes
from inspect_pipeline.inspection.anomalies.frames import Finding
from inspect_pipeline.inspection.rows import (
    completed_lines,
    find_origin,
    judge_frames,
    runs_of,
    tracked_lines,
)
from inspect_pipeline.inspection.span_evidence import SpanEvidence, gather_evidence

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from inspect_pipeline.arrays import Floats, Ints, Mask
    from inspect_pipeline.geometry.local_frame import LocalMetres
    from inspect_pipeline.inspection.rows import CameraRows
    from inspect_pipeline.inspection.rules import Rules
    from inspect_pipeline.inspection.spans import Span


_SMOOTHED_FRAMES = 31


def find_on_spans(
    camera: CameraRows,
    spans: Sequence[Span],
    origin: LocalMetres,
    is_usable: Mask,
    rules: Rules,
) -> list[Finding]:
    """The findings about conductors on all spans that usable frames of the camera show."""
    seen = gather_evidence(camera, spans, origin, is_usable, rules)
    usual = _usual_count([one.level for one in seen])
    found: list[Finding] = []
    for one in seen:
        expected = one.axis.expected_conductors or usual
        if expected:
            found += _find_deficits(one, expected, origin, rules)
            found += _find_surplus(one, expected, origin, rules)
        lanes = make_lanes(one, rules)
        sagging = list(find_sag_changes(one, lanes, origin, rules))
        # What sags may well seem to come closer to a neighbour: that is told once.
        found += sagging or find_converging(one, lanes, origin, rules)
    return found


@dataclass(frozen=True, slots=True, eq=False)
class CountRows:
    """Rows of the table conductor_counts of one camera and span: arrays (N,); None for the whole picture."""

    span_id: str | None
    frame_idx: Ints
    n_conductors: Ints


def count_conductors(camera: CameraRows, spans: Sequence[Span], rules: Rules) -> Iterator[CountRows]:
    """How many followed lines each usable frame shows, and how many conductors of each span, smoothed."""
    usable = judge_frames(camera.frames, rules).usable
    lines = completed_lines(tracked_lines(camera.lines, rules), rules.tracks["max_coast_frames"])
    if not len(lines):
        return
    each = np.unique(np.column_stack((lines.frame, lines.track)), axis=0)
    in_picture = np.bincount(each[:, 0], minlength=len(usable)).astype(np.float64)
    yield _smooth(None, camera, np.where(usable & (in_picture > 0), in_picture, np.nan))
    origin = find_origin([camera])
    for one in gather_evidence(camera, spans, origin, usable, rules) if origin else ():
        shown = np.isfinite(one.counts).any(axis=1)
        in_frame = np.full(len(usable), np.nan)
        in_frame[one.first_row + np.flatnonzero(shown)] = np.nanmedian(one.counts[shown], axis=1)
        yield _smooth(one.axis.span_id, camera, in_frame)


def _smooth(span_id: str | None, camera: CameraRows, counts: Floats) -> CountRows:
    """The median over a window of frames, for the frames that have a count."""
    padded = np.pad(counts, _SMOOTHED_FRAMES // 2, constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, _SMOOTHED_FRAMES)
    known = np.isfinite(counts)
    smooth = np.round(np.nanmedian(windows[known], axis=1)).astype(np.int64)
    return CountRows(span_id, camera.frames.frame_idx[known], smooth)


def _usual_count(levels: Sequence[Floats]) -> int:
    """The most frequent number of conductors over all bins of a flight, where no span says it."""
    known = np.concatenate([level[np.isfinite(level)] for level in levels]) if levels else np.zeros(0)
    known = known[known > 0].astype(np.int64)
    return int(np.bincount(known).argmax()) if len(known) else 0


def _inner_bins(one: SpanEvidence, rules: Rules) -> Mask:
    """(B,) what was seen, without what is next to the structures."""
    along_m, margin_m = one.axis.bins_m, rules.anomalies["margin_m"]
    is_inner: Mask = (along_m >= margin_m) & (along_m <= one.axis.length_m - margin_m)
    return is_inner & np.isfinite(one.level)


def _find_deficits(one: SpanEvidence, expected: int, origin: LocalMetres, rules: Rules) -> Iterator[Finding]:
    """Fewer conductors than expected: over the span, from somewhere to its end, or between two places."""
    known = np.flatnonzero(_inner_bins(one, rules))
    if not len(known):
        return
    bin_m = one.axis.bin_m
    lacking = _bridge(one.level[known] < expected, rules.anomalies["bridged_m"] / bin_m)
    count_limits = rules.of("conductor_count")
    if lacking.mean() >= count_limits["min_share"] and lacking.sum() * bin_m >= count_limits["min_length_m"]:
        yield _about_count(one, known[lacking], expected, origin)
        return
    for run in runs_of(lacking, 1):
        length_m = len(run) * bin_m
        is_at_end = run[0] == 0 or run[-1] == len(known) - 1
        if is_at_end and not _is_sure_of_end(one, known[run], rules):
            continue
        kind = "conductor_lost" if is_at_end else "conductor_gap"
        limit_m = rules.of(kind)["min_length_m"]
        if length_m < limit_m:
            continue
        bins = known[run]
        starts_m = one.axis.bins_m[bins[0]] - bin_m / 2
        level = int(np.median(one.level[bins]))
        if is_at_end:
            edge_m = starts_m if run[0] > 0 else one.axis.bins_m[bins[-1]] + bin_m / 2
            reason = f"{level} of {expected} conductors beyond {edge_m:.0f} m of span {one.axis.span_id}"
        else:
            where = f"{starts_m:.0f} m of span {one.axis.span_id}"
            reason = f"{level} of {expected} conductors for {length_m:.1f} m from {where}"
        yield Finding(
            kind,
            one.rows_showing(bins),
            reason,
            length_m,
            limit_m,
            "m",
            span_id=one.axis.span_id,
            place=one.place(bins, origin),
        )


def _bridge(mask: Mask, longest: float) -> Mask:
    """A mask without the short runs of False between two of True."""
    bridged = mask.copy()
    for run in runs_of(~mask, 1):
        if run[0] > 0 and run[-1] < len(mask) - 1 and len(run) <= longest:
            bridged[run] = True
    return bridged


def _is_sure_of_end(one: SpanEvidence, bins: Ints, rules: Rules) -> bool:
    """Whether bins reach a structure, but for the margin, or lines were followed when they came into sight.

    Where a flight begins amid a span, a line that is not followed yet is as good as none: there, twice as
    many frames must show them.
    """
    along_m, near_m = one.axis.bins_m[bins], 2 * rules.anomalies["margin_m"]
    if along_m[0] <= near_m or along_m[-1] >= one.axis.length_m - near_m:
        return True
    min_views, shown = rules.anomalies["min_views"], np.isfinite(one.counts)
    n_views = int(shown[:, bins].sum(axis=0).max())
    began, begins = (np.flatnonzero(mask.any(axis=1))[0] for mask in (shown, shown[:, bins]))
    return bool(begins - began >= min_views or n_views >= 2 * min_views)


def _find_surplus(one: SpanEvidence, expected: int, origin: LocalMetres, rules: Rules) -> Iterator[Finding]:
    known = np.flatnonzero(_inner_bins(one, rules))
    limits = rules.of("conductor_count")
    surplus = one.level[known] > expected
    is_long = surplus.sum() * one.axis.bin_m >= limits["min_length_m"]
    if len(known) and is_long and surplus.mean() >= limits["min_share"]:
        yield _about_count(one, known[surplus], expected, origin)


def _about_count(one: SpanEvidence, bins: Ints, expected: int, origin: LocalMetres) -> Finding:
    level = int(np.median(one.level[bins]))
    reason = f"{level} conductors along span {one.axis.span_id}, where {expected} are expected"
    rows = one.rows_showing(bins)
    place = one.place(bins, origin)
    return Finding(
        "conductor_count",
        rows,
        reason,
        level,
        expected,
        "conductors",
        span_id=one.axis.span_id,
        place=place,
    )
