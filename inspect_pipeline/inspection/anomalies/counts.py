"""Number of conductors per frame, for charts: over the whole image and for each span."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from inspect_pipeline.inspection.rows import assess_frames
from inspect_pipeline.inspection.span_evidence import evidence_lines

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from inspect_pipeline.arrays import Floats, Ints
    from inspect_pipeline.inspection.rows import CameraRows
    from inspect_pipeline.inspection.rules import Rules
    from inspect_pipeline.inspection.span_evidence import SpanEvidence

_SMOOTHED_FRAMES = 31


@dataclass(frozen=True, slots=True, eq=False)
class CountRows:
    """Rows of the table conductor_counts for one camera and span: arrays (N,). Span None: the whole image."""

    channel_id: int
    span_id: str | None
    frame_idx: Ints
    n_conductors: Ints


def count_conductors(
    camera: CameraRows, evidence: Sequence[SpanEvidence], rules: Rules
) -> Iterator[CountRows]:
    """Count the confirmed lines of each usable frame, and the conductors of each span, smoothed."""
    usable = assess_frames(camera.frames, rules).usable
    lines = evidence_lines(camera, rules)
    if not len(lines):
        return
    distinct = np.unique(np.column_stack((lines.frame, lines.track)), axis=0)
    in_image = np.bincount(distinct[:, 0], minlength=len(usable)).astype(np.float64)
    yield _smooth(None, camera, np.where(usable & (in_image > 0), in_image, np.nan))
    for one in evidence:
        if one.votes is not None and one.is_present.any():
            n_found = one.votes.in_frame.sum(axis=1)
            in_frame = np.full(len(usable), np.nan)
            in_frame[one.sight.rows] = np.where(n_found > 0, n_found, np.nan)
            yield _smooth(one.axis.span_id, camera, in_frame)


def _smooth(span_id: str | None, camera: CameraRows, counts: Floats) -> CountRows:
    """Return the median over a window of frames, for the frames with a count."""
    padded = np.pad(counts, _SMOOTHED_FRAMES // 2, constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, _SMOOTHED_FRAMES)
    known = np.isfinite(counts)
    smooth = np.round(np.nanmedian(windows[known], axis=1)).astype(np.int64)
    return CountRows(camera.channel_id, span_id, camera.frames.frame_idx[known], smooth)
