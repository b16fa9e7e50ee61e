"""What of a flight frames stand for: those that came and are usable, those with lines, and the gaps."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from inspect_pipeline.inspection.coverage.rows import Coverage, Gap
from inspect_pipeline.inspection.rows import (
    completed_lines,
    judge_frames,
    path_metres,
    runs_of,
    tracked_lines,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

    from inspect_pipeline.arrays import Floats, Mask
    from inspect_pipeline.inspection.rows import CameraRows
    from inspect_pipeline.inspection.rules import Rules


_MIN_GAP_FRAMES = 5  # without lines, before it is called a gap
_MAX_LOST = 2**31 - 1  # what its column holds; clocks that jump by centuries lose more


def measure_frames(camera: CameraRows, rules: Rules) -> Coverage:
    frames = camera.frames
    usable = int(judge_frames(frames, rules).usable.sum())
    is_regular = len(frames) > 1 and frames.period_s > 0
    expected = round(frames.times_s[-1] / frames.period_s) + 1 if is_regular else len(frames)
    gaps = list(find_dropouts(camera, rules))
    lengths_m = [gap.length_m for gap in gaps if gap.length_m is not None]
    return Coverage(
        "frame",
        camera.channel_id,
        None,
        "frames",
        total=float(max(expected, len(frames))),
        imaged=None,
        covered=float(usable),
        longest_gap_s=max((gap.duration_s for gap in gaps), default=0.0),
        longest_gap_m=max(lengths_m, default=None),
        thresholds=dict(rules.frames),
    )


def measure_detection(camera: CameraRows, rules: Rules) -> Iterator[Coverage]:
    """By time and by path: a frame stands for half the way to its neighbours, unless frames are missing."""
    frames, found = camera.frames, has_lines(camera, rules)
    pauses = np.diff(frames.times_s)
    is_whole = pauses <= rules.frames["dropout_factor"] * frames.period_s
    share = np.where(is_whole, (found[:-1].astype(np.float64) + found[1:]) / 2, 0.0)
    gaps = list(find_detection_gaps(camera, rules))
    lengths_m = [gap.length_m for gap in gaps if gap.length_m is not None]
    steps_m = np.diff(path_metres(frames))
    known = np.isfinite(steps_m)
    thresholds = {**rules.tracks, "dropout_factor": rules.frames["dropout_factor"]}
    measures: list[tuple[Literal["s", "m"], Floats, Floats]] = [("s", pauses, share)]
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
    """Pauses between frames."""
    frames, walked = camera.frames, path_metres(camera.frames)
    pauses = np.diff(frames.times_s)
    factor = rules.frames["dropout_factor"]
    for i in np.flatnonzero(pauses > factor * frames.period_s).tolist() if len(pauses) else ():
        n_lost = max(1, round(pauses[i] / frames.period_s) - 1) if frames.period_s > 0 else 1
        yield _gap("frame", camera, (i, i + 1), min(n_lost, _MAX_LOST), walked)


def find_detection_gaps(camera: CameraRows, rules: Rules) -> Iterator[Gap]:
    """Stretches of good frames without lines; bad frames neither count nor interrupt."""
    good = np.flatnonzero(camera.frames.is_ok)
    walked = path_metres(camera.frames)
    for run in runs_of(~has_lines(camera, rules)[good], _MIN_GAP_FRAMES):
        yield _gap("detection", camera, (int(good[run[0]]), int(good[run[-1]])), len(run), walked)


def _gap(
    kind: Literal["frame", "detection"], camera: CameraRows, rows: tuple[int, int], n: int, walked: Floats
) -> Gap:
    first, last = rows
    frames, length_m = camera.frames, walked[last] - walked[first]
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
    """(N,) whether a frame has a line that was followed, be it missed in this frame."""
    lines = tracked_lines(camera.lines, rules)
    if len(lines) and np.any(lines.track >= 0):
        lines = completed_lines(lines, rules.tracks["max_missed_frames"])
    found = np.zeros(len(camera.frames), bool)
    found[lines.frame] = True
    return found & camera.frames.is_ok
