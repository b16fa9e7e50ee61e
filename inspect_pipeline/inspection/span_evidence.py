"""What the frames of a camera show of the conductors of spans: how many, where, in which frames.

How many conductors a frame shows in a bin is one number; what counts is the median over frames, so that a
line missed here or clutter taken for one there says nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from inspect_pipeline.inspection.rows import NO_TRACK, completed_lines, place_cameras, tracked_lines
from inspect_pipeline.inspection.span_view import cut_to_sight, is_near, make_axis, view_span, visible_gsd_m

if TYPE_CHECKING:
    from collections.abc import Sequence

    from inspect_pipeline.arrays import Floats, Ints, Mask
    from inspect_pipeline.geometry.camera import CameraPoses
    from inspect_pipeline.geometry.local_frame import LocalMetres
    from inspect_pipeline.inspection.rows import CameraRows, LineRows
    from inspect_pipeline.inspection.rules import Rules
    from inspect_pipeline.inspection.span_view import SpanAxis, SpanView
    from inspect_pipeline.inspection.spans import Span


_SAME_PX = 8.0  # between two lines that are one
_FAR_APART_M = 1000.0
_OUTERMOST = (0.02, 0.98)  # quantiles of where lines lie across


@dataclass(frozen=True, eq=False)
class SpanEvidence:
    """What the frames of a camera show of the conductors of a span.

    It has the N frames from `first_row` on. counts (N, B): conductors side by side in a bin, NaN where a
    frame does not show it. level (B,) is the median over frames, NaN for bins that too few frames show. view
    has what was found in the very frames.
    """

    first_row: int
    axis: SpanAxis
    view: SpanView
    cameras: CameraPoses
    lines_track: Ints
    counts: Floats
    level: Floats

    def rows_showing(self, bins: Ints) -> Ints:
        """The frames from the first to the last that show at least half as many of some bins as any does."""
        shown = np.isfinite(self.counts[:, bins]).sum(axis=1)
        rows = np.flatnonzero(shown >= max(1.0, shown.max() / 2))
        return self.first_row + np.arange(rows[0], rows[-1] + 1)

    def place(self, bins: Ints, origin: LocalMetres) -> tuple[float, float]:
        """Latitude and longitude of the middle of some bins."""
        lat_deg, lon_deg = origin.to_degrees(self.axis.middles[bins, :2].mean(axis=0))
        return float(lat_deg), float(lon_deg)


def gather_evidence(
    camera: CameraRows, spans: Sequence[Span], origin: LocalMetres, is_usable: Mask, rules: Rules
) -> list[SpanEvidence]:
    """The evidence of each span that enough frames of a camera show."""
    lines = completed_lines(tracked_lines(camera.lines, rules), rules.tracks["max_coast_frames"])
    if not len(lines) or not np.any(lines.track != NO_TRACK):
        return []
    cameras = place_cameras(camera.frames, origin, rules)
    cameras.positions[~is_usable] = np.nan
    path = cameras.positions[np.isfinite(cameras.positions).all(axis=1), :2]
    seen = []
    for span in spans:
        axis = make_axis(span, origin, rules)
        if not is_near(axis.middles[:, :2], path, rules.coverage["near_m"]):
            continue
        sight = cut_to_sight(axis.middles, cameras, lines)
        own = sight.lines
        view = _without_echoes(view_span(axis, sight.cameras, own, rules), own)
        counts = np.where(_shows_all(axis, view, sight.cameras, rules), 0.0, np.nan)
        # Pieces of one track are one conductor, however they overlap.
        each = np.unique(np.column_stack((view.frame, view.bin, own.track[view.line])), axis=0)
        np.add.at(counts, (each[:, 0], each[:, 1]), 1.0)
        level = _level(counts, rules)
        if np.isfinite(level).any():
            found = view.select(own.picture[view.line] == view.frame)
            first_row = sight.rows.start
            seen.append(SpanEvidence(first_row, axis, found, sight.cameras, own.track, counts, level))
    return seen


def _without_echoes(view: SpanView, lines: LineRows) -> SpanView:
    """The view without lines of an earlier frame where this one has a line at the same place.

    That line went over to another track.
    """
    is_old = lines.picture[view.line] != view.frame
    place = (view.frame * view.gsd_m.shape[1] + view.bin) * _FAR_APART_M + view.across_m
    found = np.sort(place[~is_old])
    if not len(found):
        return view
    after = np.clip(np.searchsorted(found, place), 1, max(1, len(found) - 1))
    nearest_m = np.minimum(
        np.abs(place - found[after - 1]), np.abs(place - found[np.minimum(after, len(found) - 1)])
    )
    is_echo = is_old & (nearest_m <= _SAME_PX * view.gsd_m[view.frame, view.bin])
    return view.select(~is_echo)


def _shows_all(axis: SpanAxis, view: SpanView, cameras: CameraPoses, rules: Rules) -> Mask:
    """(N, B) whether a frame shows a bin as far to both sides as there are lines in any."""
    if not len(view.across_m):
        return np.isfinite(view.gsd_m)
    is_shown = np.ones(view.gsd_m.shape, bool)
    middles = axis.start + axis.bins_m[:, np.newaxis] * axis.along
    for side_m in np.quantile(view.across_m, _OUTERMOST):
        places = np.column_stack((middles + side_m * axis.across, np.full(len(middles), axis.height_m)))
        is_shown &= np.isfinite(visible_gsd_m(cameras, places, rules.anomalies["margin_px"]))
    return is_shown


def _level(counts: Floats, rules: Rules) -> Floats:
    """The median over frames of each bin that enough of them show; NaN elsewhere."""
    level = np.full(counts.shape[1], np.nan)
    is_known = np.isfinite(counts).sum(axis=0) >= rules.anomalies["min_views"]
    level[is_known] = np.round(np.nanmedian(counts[:, is_known], axis=0))
    return level
