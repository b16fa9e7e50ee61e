"""Evidence about the conductors of a span: how many are visible in each bin, in which frames, and how surely.

Each frame votes on the number of conductors in a bin. A vote weighs more the finer the frame shows the bin,
and the more conductors of the span the frame has at all: a line that ends within a frame says more than one
that the frame lacks, which the detector may have missed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from inspect_pipeline.inspection.judgement import judge_bins
from inspect_pipeline.inspection.lines import carry_over, confirmed_lines, number_untracked
from inspect_pipeline.inspection.poses import camera_poses, find_pose_problems
from inspect_pipeline.inspection.rows import find_runs
from inspect_pipeline.inspection.span_view import (
    make_axis,
    near_path,
    select_frames,
    view_span,
    visible_gsd_m,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from inspect_pipeline.arrays import Floats, Ints, Mask
    from inspect_pipeline.geometry.camera import CameraPoses
    from inspect_pipeline.geometry.local_frame import LocalMetres
    from inspect_pipeline.inspection.rows import CameraRows, LineRows
    from inspect_pipeline.inspection.rules import Rules
    from inspect_pipeline.inspection.span_view import FrameRange, SpanAxis, SpanView
    from inspect_pipeline.inspection.spans import Span


_SAME_PX = 8.0  # between two lines of one conductor
_FAR_APART_M = 1000.0
_OUTERMOST = (0.02, 0.98)  # quantiles of where lines lie across
_FEW_VIEWS = 6  # up to which a median says little
_SAME_M, _MIN_VIEW_SHARE = 0.4, 0.3  # of one conductor in different frames
_MAX_ALIGNED = 0.2  # of the frames that show a bin
_INCOMPLETE_WEIGHT = 0.5  # of a frame that shows fewer conductors of the span than most


@dataclass(frozen=True, eq=False)
class SpanEvidence:
    """Evidence of the N frames from `first_row` on about the conductors of a span of B bins.

    counts (N, B): conductors side by side, NaN where a frame does not show a bin or wires line up in it.
    weights (N, B): of these counts, 0 where NaN. level (B,): their weighted median, NaN where the evidence is
    too weak. outcome (B,): 0 where judged, else the reason, see `judgement`. view: lines detected in the very
    frames, without those carried over.
    """

    first_row: int
    axis: SpanAxis
    view: SpanView
    cameras: CameraPoses
    lines_track: Ints
    counts: Floats
    weights: Floats
    level: Floats
    outcome: Ints

    def rows_showing(self, bins: Ints) -> Ints:
        """Return the frames from the first to the last that show at least half of the visible bins."""
        shown = np.isfinite(self.counts[:, bins]).sum(axis=1)
        rows = np.flatnonzero(shown >= max(1.0, shown.max() / 2))
        return self.first_row + np.arange(rows[0], rows[-1] + 1)

    def place(self, bins: Ints, origin: LocalMetres) -> tuple[float, float]:
        """Return latitude and longitude of the middle of some bins."""
        lat_deg, lon_deg = origin.to_degrees(self.axis.centres[bins, :2].mean(axis=0))
        return float(lat_deg), float(lon_deg)


def gather_evidence(
    camera: CameraRows, spans: Sequence[Span], origin: LocalMetres, is_usable: Mask, rules: Rules
) -> Iterator[SpanEvidence]:
    """Yield the evidence about each span near the path of a camera."""
    lines = evidence_lines(camera, rules)
    cameras = camera_poses(camera.frames, origin, rules)
    problems = find_pose_problems(camera.frames, is_usable, rules)
    cameras.positions[~is_usable] = np.nan
    path = origin.to_metres(camera.frames.lat_deg, camera.frames.lon_deg)
    known = np.isfinite(path).all(axis=1)
    for span in spans:
        axis = make_axis(span, origin, rules)
        near = near_path(axis.centres[:, :2], path[known], rules.coverage["near_m"])
        if near.any():
            frames = select_frames(axis.centres, cameras, lines)
            yield _gather_span(axis, frames, (path[known], problems[known]), rules)


def evidence_lines(camera: CameraRows, rules: Rules) -> LineRows:
    """Return lines confirmed by tracks and carried over missed frames; of photographs all lines."""
    if camera.cadence(rules).is_video:
        return carry_over(confirmed_lines(camera.lines, rules), rules.tracks["max_coast_frames"])
    return number_untracked(camera.lines)


def _gather_span(
    axis: SpanAxis, frames: FrameRange, path_problems: tuple[Floats, Ints], rules: Rules
) -> SpanEvidence:
    lines = frames.lines
    view = _drop_repeats(view_span(axis, frames.cameras, lines, rules), lines)
    shown = _shows_full_width(axis, view, frames.cameras, rules)
    coarse = view.gsd_m > rules.coverage["max_gsd_m"]
    counts = _count_conductors(view, lines, shown & ~coarse)
    aligned = _find_aligned(view, lines, counts, rules)
    counts[aligned] = np.nan
    detected = view.select(lines.detected_in[view.line] == view.frame)
    weights = _weigh_views(counts, detected, lines, rules)
    # Frames in which wires merged look complete: where many are aligned, none is trusted.
    weights[:, aligned.sum(axis=0) > _MAX_ALIGNED * (shown & ~coarse).sum(axis=0)] = 0.0
    level = _weighted_median(counts, weights, rules.anomalies["min_evidence"])
    _merge_views(level, view, weights)
    outcome = judge_bins(axis, np.isfinite(level), (shown, coarse, aligned), path_problems, rules)
    return SpanEvidence(
        first_row=frames.rows.start,
        axis=axis,
        view=detected,
        cameras=frames.cameras,
        lines_track=lines.track,
        counts=counts,
        weights=weights,
        level=level,
        outcome=outcome,
    )


def _drop_repeats(view: SpanView, lines: LineRows) -> SpanView:
    """Drop lines carried over from an earlier frame where this frame has a line in the same place.

    Such a line changed its track.
    """
    carried = lines.detected_in[view.line] != view.frame
    place = (view.frame * view.gsd_m.shape[1] + view.bin) * _FAR_APART_M + view.across_m
    detected = np.sort(place[~carried])
    if not len(detected):
        return view
    after = np.clip(np.searchsorted(detected, place), 1, max(1, len(detected) - 1))
    nearest_m = np.minimum(
        np.abs(place - detected[after - 1]),
        np.abs(place - detected[np.minimum(after, len(detected) - 1)]),
    )
    is_repeat = carried & (nearest_m <= _SAME_PX * view.gsd_m[view.frame, view.bin])
    return view.select(~is_repeat)


def _shows_full_width(axis: SpanAxis, view: SpanView, cameras: CameraPoses, rules: Rules) -> Mask:
    """Return whether a frame shows a bin (N, B) over the full width of the conductors."""
    shown = np.isfinite(view.gsd_m)
    if not len(view.across_m):
        return shown
    centres = axis.start + axis.bins_m[:, np.newaxis] * axis.along
    for side_m in np.quantile(view.across_m, _OUTERMOST):
        points = np.column_stack((centres + side_m * axis.across, np.full(len(centres), axis.height_m)))
        shown &= np.isfinite(visible_gsd_m(cameras, points, rules.anomalies["margin_px"]))
    return shown


def _count_conductors(view: SpanView, lines: LineRows, shown: Mask) -> Floats:
    """Return the number of distinct tracks (N, B), NaN where a bin is not shown."""
    counts = np.where(shown, 0.0, np.nan)
    distinct = np.unique(np.column_stack((view.frame, view.bin, lines.track[view.line])), axis=0)
    np.add.at(counts, (distinct[:, 0], distinct[:, 1]), 1.0)
    return counts


def _find_aligned(view: SpanView, lines: LineRows, counts: Floats, rules: Rules) -> Mask:
    """Return the bins (N, B) in which two conductors nearly coincide in the image, or may coincide.

    They may coincide in the bins next to these in which the frame shows fewer conductors.
    """
    aligned = np.zeros(counts.shape, bool)
    order = np.lexsort((view.across_m, view.bin, view.frame))
    frame, bins, across_m = view.frame[order], view.bin[order], view.across_m[order]
    track = lines.track[view.line[order]]
    is_pair = (frame[1:] == frame[:-1]) & (bins[1:] == bins[:-1]) & (track[1:] != track[:-1])
    apart_px = np.diff(across_m) / view.gsd_m[frame[1:], bins[1:]]
    close = np.flatnonzero(is_pair & (apart_px < rules.anomalies["aligned_px"]))
    aligned[frame[close + 1], bins[close + 1]] = True
    for row in np.flatnonzero(aligned.any(axis=1)).tolist():
        most = np.nanmax(counts[row], initial=0.0)
        for run in find_runs(counts[row] < most, 1):
            if aligned[row, max(run[0] - 1, 0)] or aligned[row, min(run[-1] + 1, len(counts[row]) - 1)]:
                aligned[row, run] = True
    return aligned


def _weigh_views(counts: Floats, detected: SpanView, lines: LineRows, rules: Rules) -> Floats:
    """Return the weights (N, B) of counts by resolution and by the completeness of their frames.

    detected: the view without lines carried over from other frames.
    """
    with np.errstate(invalid="ignore"):
        fineness = np.clip(1.5 - detected.gsd_m / rules.coverage["max_gsd_m"], 0.5, 1.0)
    in_frame = _count_conductors(detected, lines, np.ones(counts.shape, bool)).max(axis=1)
    usual = np.median(in_frame[in_frame > 0]) if (in_frame > 0).any() else 0.0
    complete = np.where(in_frame >= usual, 1.0, _INCOMPLETE_WEIGHT)
    weights: Floats = np.where(np.isfinite(counts), fineness * complete[:, np.newaxis], 0.0)
    return weights


def _weighted_median(counts: Floats, weights: Floats, min_evidence: float) -> Floats:
    """Return the weighted median of counts of each bin (B,), NaN where the total weight is too low."""
    level = np.full(counts.shape[1], np.nan)
    for i in np.flatnonzero(weights.sum(axis=0) >= min_evidence).tolist():
        known = np.flatnonzero(weights[:, i] > 0)
        known = known[np.argsort(-counts[known, i], kind="stable")]  # from the most: ties assume a miss
        total = np.cumsum(weights[known, i])
        level[i] = counts[known[np.searchsorted(total, total[-1] / 2)], i]
    return level


def _merge_views(level: Floats, view: SpanView, weights: Floats) -> None:
    """Raise the level (B,) of bins with few views by conductors that different frames missed.

    Lines of different frames belong to one conductor where they are close across. The level is raised to
    the highest of the span at most, as clutter may add lines.
    """
    n_views = (weights > 0).sum(axis=0)
    highest = np.nanmax(level, initial=0.0)
    for i in np.flatnonzero((n_views <= _FEW_VIEWS) & (level < highest)).tolist():
        here = (view.bin == i) & (weights[view.frame, i] > 0)
        order = np.argsort(view.across_m[here])
        frame, across_m = view.frame[here][order], view.across_m[here][order]
        groups = np.split(frame, np.flatnonzero(np.diff(across_m) > _SAME_M) + 1)
        # Two lines of one frame in a group are two conductors.
        per_frame = [np.unique(group, return_counts=True)[1] for group in groups]
        least = _MIN_VIEW_SHARE * n_views[i]
        n_conductors = sum(counts.max() for counts in per_frame if len(counts) >= least)
        level[i] = max(level[i], min(n_conductors, highest))
