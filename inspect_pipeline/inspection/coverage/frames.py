"""Coverage by frames and by detections, and the gaps in both."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from inspect_pipeline.inspection.coverage.rows import Coverage, Gap
from inspect_pipeline.inspection.lines import carry_over, confirmed_lines
from inspect_pipeline.inspection.poses import distance_flown_m
from inspect_pipeline.inspection.rows import assess_frames, find_runs

if TYPE_CHECKING:
    from collections.abc import Iterator

    from inspect_pipeline.arrays import Floats, Mask
    from inspect_pipeline.inspection.rows import CameraRows
    from inspect_pipeline.inspection.rules import Rules


_MIN_GAP_FRAMES = 5  # without lines
_MAX_MISSING = 2**31 - 1  # limit of the column, which clocks that jump by centuries exceed


def measure_frames(camera: CameraRows, rules: Rules) -> Coverage:
    """Return the share of usable frames among those that the frame rate predicts."""
    frames = camera.frames
    usable = int(assess_frames(frames, rules).usable.sum())
    expected = camera.cadence(rules).expected_frames(frames.times_s)
    gaps = list(find_dropouts(camera, rules))
    lengths_m = [gap.length_m for gap in gaps if gap.length_m is not None]
    return Coverage(
        "frame",
        camera.channel_id,
        None,
        "frames",
        total=float(expected),
        imaged=None,
        covered=float(usable),
        longest_gap_s=max((gap.duration_s for gap in gaps), default=0.0),
        longest_gap_m=max(lengths_m, default=None),
        thresholds=dict(rules.frames),
    )


def measure_detection(camera: CameraRows, rules: Rules) -> Iterator[Coverage]:
    """Yield the shares of time and of path with lines. Pauses with missing frames are not covered."""
    frames, found = camera.frames, has_lines(camera, rules)
    # Each frame counts for half of the way to its neighbours.
    share = (found[:-1].astype(np.float64) + found[1:]) / 2
    share[camera.cadence(rules).find_pauses(frames.times_s)] = 0.0
    gaps = list(find_detection_gaps(camera, rules))
    lengths_m = [gap.length_m for gap in gaps if gap.length_m is not None]
    steps_m = np.diff(distance_flown_m(frames))
    known = np.isfinite(steps_m)
    thresholds = {**rules.tracks, "dropout_factor": rules.frames["dropout_factor"]}
    measures: list[tuple[Literal["s", "m"], Floats, Floats]] = [("s", np.diff(frames.times_s), share)]
    if known.any():
        measures.append(("m", steps_m[known], share[known]))
    for unit, steps, shares in measures:
        yield Coverage(
            "detection",
            camera.channel_id,
            None,
            unit,
            total=float(steps.sum()),
            imaged=None,
            covered=float((steps * shares).sum()),
            longest_gap_s=max((gap.duration_s for gap in gaps), default=0.0),
            longest_gap_m=max(lengths_m, default=None),
            thresholds=thresholds,
        )


def find_dropouts(camera: CameraRows, rules: Rules) -> Iterator[Gap]:
    """Yield the pauses of a video in which frames are missing."""
    times_s, flown = camera.frames.times_s, distance_flown_m(camera.frames)
    cadence = camera.cadence(rules)
    for i in cadence.find_pauses(times_s).tolist():
        n_missing = cadence.missing_frames(float(times_s[i + 1] - times_s[i]))
        yield _gap("frame", camera, (i, i + 1), min(n_missing, _MAX_MISSING), flown)


def find_detection_gaps(camera: CameraRows, rules: Rules) -> Iterator[Gap]:
    """Yield runs of good frames without lines. Bad frames neither count nor interrupt."""
    good = np.flatnonzero(camera.frames.is_ok)
    flown = distance_flown_m(camera.frames)
    for run in find_runs(~has_lines(camera, rules)[good], _MIN_GAP_FRAMES):
        yield _gap("detection", camera, (int(good[run[0]]), int(good[run[-1]])), len(run), flown)


def _gap(
    kind: Literal["frame", "detection"], camera: CameraRows, rows: tuple[int, int], n: int, flown: Floats
) -> Gap:
    first, last = rows
    frames, length_m = camera.frames, flown[last] - flown[first]
    return Gap(
        kind,
        camera.channel_id,
        int(frames.frame_idx[first]),
        int(frames.frame_idx[last]),
        n,
        int(frames.log_time_ns[first]),
        int(frames.log_time_ns[last]),
        float(length_m) if np.isfinite(length_m) else None,
    )


def has_lines(camera: CameraRows, rules: Rules) -> Mask:
    """Return whether a frame (N,) has a confirmed line, possibly missed in this very frame."""
    lines = confirmed_lines(camera.lines, rules)
    if len(lines) and np.any(lines.track >= 0):
        lines = carry_over(lines, rules.tracks["max_missed_frames"])
    found = np.zeros(len(camera.frames), bool)
    found[lines.frame] = True
    return found & camera.frames.is_ok
