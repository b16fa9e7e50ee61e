"""Rules about frame quality, times and poses. They need no lines."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from inspect_pipeline.inspection.rows import find_runs

if TYPE_CHECKING:
    from collections.abc import Iterator

    from inspect_pipeline.arrays import Ints
    from inspect_pipeline.inspection.rows import CameraRows, FrameQuality
    from inspect_pipeline.inspection.rules import Rules


@dataclass(frozen=True, slots=True, eq=False)
class Finding:
    """Result of a rule: rows of the frames that show it, and the value that passed the threshold.

    place is latitude and longitude in degrees, None for the position of the camera. conductors: numbers of
    those of a span that it is about.
    """

    kind: str
    rows: Ints
    reason: str
    value: float
    threshold: float
    unit: str
    track_id: int | None = None
    span_id: str | None = None
    place: tuple[float, float] | None = None
    conductors: tuple[int, ...] = ()


def find_blurred(camera: CameraRows, quality: FrameQuality, rules: Rules) -> Iterator[Finding]:
    """Find frames far less sharp than the median of the flight."""
    good = camera.frames.sharpness[quality.usable | quality.blurred]
    median = float(np.nanmedian(good)) if np.isfinite(good).any() else np.nan
    limit = rules.frames["blurred_below"] * median
    for rows in find_runs(quality.blurred, rules.of("blurred_frames")["min_frames"]):
        least = float(np.nanmin(camera.frames.sharpness[rows]))
        reason = f"{len(rows)} blurred frames: sharpness down to {least:.0f}, median {median:.0f}"
        yield Finding("blurred_frames", rows, reason, least, limit, "sharpness")


def find_dark(camera: CameraRows, quality: FrameQuality, rules: Rules) -> Iterator[Finding]:
    """Find frames that are too dark."""
    for rows in find_runs(quality.dark, rules.of("dark_frames")["min_frames"]):
        least = float(camera.frames.mean_luma[rows].min())
        reason = f"{len(rows)} dark frames: mean luma down to {least:.0f} of 255"
        yield Finding("dark_frames", rows, reason, least, rules.frames["dark_below_luma"], "luma")


def find_overexposed(camera: CameraRows, quality: FrameQuality, rules: Rules) -> Iterator[Finding]:
    """Find frames that are too bright."""
    for rows in find_runs(quality.overexposed, rules.of("overexposed_frames")["min_frames"]):
        most = float(camera.frames.mean_luma[rows].max())
        reason = f"{len(rows)} overexposed frames: mean luma up to {most:.0f} of 255"
        limit = rules.frames["overexposed_above_luma"]
        yield Finding("overexposed_frames", rows, reason, most, limit, "luma")


def find_dropouts(camera: CameraRows, _quality: FrameQuality, rules: Rules) -> Iterator[Finding]:
    """Find pauses of a video, from the frame before to the frame after."""
    times_s = camera.frames.times_s
    cadence = camera.cadence(rules)
    limit_s = cadence.max_pause_s
    for i in cadence.find_pauses(times_s).tolist():
        pause_s = float(times_s[i + 1] - times_s[i])
        n_missing = cadence.missing_frames(pause_s)
        if n_missing >= rules.of("sensor_dropout")["min_frames"]:
            reason = f"no frame for {pause_s:.2f} s; about {n_missing} are missing"
            yield Finding("sensor_dropout", np.array([i, i + 1]), reason, pause_s, limit_s, "s")


def find_clock_steps(camera: CameraRows, _quality: FrameQuality, rules: Rules) -> Iterator[Finding]:
    """Find jumps of the camera's clock relative to the recorder's, from one frame to the next.

    A single late message is no jump: the difference must stay. Coarse log times allow for their tick.
    """
    frames = camera.frames
    tick_s = camera.cadence(rules).resolution_s
    limit_s = rules.of("clock_step")["min_step_s"] + tick_s
    ahead_s = (frames.stamp_ns - frames.log_time_ns) / 1e9
    n = len(ahead_s)
    for i in np.flatnonzero(np.abs(np.diff(ahead_s)) >= limit_s).tolist():
        before, after = np.median(ahead_s[max(0, i - 2) : i + 1]), np.median(ahead_s[i + 1 : min(n, i + 4)])
        step_s = float(after - before)
        if abs(step_s) >= limit_s:
            reason = f"the camera's clock jumps by {step_s:+.3f} s relative to the recorder's"
            yield Finding("clock_step", np.array([i, i + 1]), reason, abs(step_s), limit_s, "s")


def find_stale_poses(camera: CameraRows, _quality: FrameQuality, rules: Rules) -> Iterator[Finding]:
    """Find frames with an old pose, from the frame at which it was last new."""
    ages_ms, limit_ms = camera.frames.pose_age_ms, rules.of("stale_pose")["max_age_ms"]
    for rows in find_runs(ages_ms > limit_ms, 1):
        oldest_ms = float(ages_ms[rows].max())
        received_ns = camera.frames.log_time_ns[rows[0]] - int(ages_ms[rows[0]] * 1e6)
        first = int(np.searchsorted(camera.frames.log_time_ns, received_ns))
        interval = np.arange(first, rows[-1] + 1)
        reason = f"the pose is up to {oldest_ms / 1e3:.1f} s old"
        yield Finding("stale_pose", interval, reason, oldest_ms, limit_ms, "ms")


FRAME_RULES = (
    find_blurred,
    find_dark,
    find_overexposed,
    find_dropouts,
    find_clock_steps,
    find_stale_poses,
)
