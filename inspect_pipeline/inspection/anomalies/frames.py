"""Rules about single frames, times and poses: they need no lines."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from inspect_pipeline.inspection.rows import runs_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from inspect_pipeline.arrays import Ints
    from inspect_pipeline.inspection.rows import CameraRows, Usable
    from inspect_pipeline.inspection.rules import Rules


@dataclass(frozen=True, slots=True, eq=False)
class Finding:
    """What a rule found: the rows of the frames that show it, and the value that passed the threshold.

    place is latitude and longitude in degrees, None for that of the camera.
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


def find_blurred(camera: CameraRows, usable: Usable, rules: Rules) -> Iterator[Finding]:
    """Frames whose sharpness is far below what is usual in this flight."""
    good = camera.frames.sharpness[usable.usable | usable.blurred]
    usual = float(np.nanmedian(good)) if np.isfinite(good).any() else np.nan
    limit = rules.frames["blurred_below"] * usual
    for rows in runs_of(usable.blurred, rules.of("blurred_frames")["min_frames"]):
        least = float(np.nanmin(camera.frames.sharpness[rows]))
        reason = f"{len(rows)} blurred frames: sharpness down to {least:.0f}, usually {usual:.0f}"
        yield Finding("blurred_frames", rows, reason, least, limit, "sharpness")


def find_dark(camera: CameraRows, usable: Usable, rules: Rules) -> Iterator[Finding]:
    """Frames too dark to see anything."""
    for rows in runs_of(usable.dark, rules.of("dark_frames")["min_frames"]):
        least = float(camera.frames.mean_luma[rows].min())
        reason = f"{len(rows)} dark frames: mean luma down to {least:.0f} of 255"
        yield Finding("dark_frames", rows, reason, least, rules.frames["dark_below_luma"], "luma")


def find_overexposed(camera: CameraRows, usable: Usable, rules: Rules) -> Iterator[Finding]:
    """Frames too bright to see anything."""
    for rows in runs_of(usable.overexposed, rules.of("overexposed_frames")["min_frames"]):
        most = float(camera.frames.mean_luma[rows].max())
        reason = f"{len(rows)} overexposed frames: mean luma up to {most:.0f} of 255"
        limit = rules.frames["overexposed_above_luma"]
        yield Finding("overexposed_frames", rows, reason, most, limit, "luma")


def find_dropouts(camera: CameraRows, _usable: Usable, rules: Rules) -> Iterator[Finding]:
    """Pauses in which frames should have come; from the frame before to the frame after."""
    frames = camera.frames
    pauses_s = np.diff(frames.times_s)
    limit_s = rules.frames["dropout_factor"] * frames.period_s
    for i in np.flatnonzero(pauses_s > limit_s).tolist() if len(pauses_s) else ():
        n_lost = round(pauses_s[i] / frames.period_s) - 1 if frames.period_s > 0 else 1
        if n_lost >= rules.of("sensor_dropout")["min_frames"]:
            reason = f"no frame for {pauses_s[i]:.2f} s; about {n_lost} are missing"
            yield Finding("sensor_dropout", np.array([i, i + 1]), reason, pauses_s[i], limit_s, "s")


def find_clock_steps(camera: CameraRows, _usable: Usable, rules: Rules) -> Iterator[Finding]:
    """Jumps of the camera's clock against that of the recorder, from one frame to the next.

    A single late message is none: the difference must stay where it jumped to.
    """
    frames, limit_s = camera.frames, rules.of("clock_step")["min_step_s"]
    ahead_s = (frames.stamp_ns - frames.log_time_ns) / 1e9
    n = len(ahead_s)
    for i in np.flatnonzero(np.abs(np.diff(ahead_s)) >= limit_s).tolist():
        before, after = np.median(ahead_s[max(0, i - 2) : i + 1]), np.median(ahead_s[i + 1 : min(n, i + 4)])
        step_s = float(after - before)
        if abs(step_s) >= limit_s:
            reason = f"the camera's clock jumps by {step_s:+.3f} s against the recorder's"
            yield Finding("clock_step", np.array([i, i + 1]), reason, abs(step_s), limit_s, "s")


def find_stale_poses(camera: CameraRows, _usable: Usable, rules: Rules) -> Iterator[Finding]:
    """Frames whose pose is old; from the frame at which it was last fresh."""
    ages_ms, limit_ms = camera.frames.pose_age_ms, rules.of("stale_pose")["max_age_ms"]
    for rows in runs_of(ages_ms > limit_ms, 1):
        oldest_ms = float(ages_ms[rows].max())
        # The pose was last heard of that long before the first of these frames.
        heard_ns = camera.frames.log_time_ns[rows[0]] - int(ages_ms[rows[0]] * 1e6)
        first = int(np.searchsorted(camera.frames.log_time_ns, heard_ns))
        whole = np.arange(first, rows[-1] + 1)
        reason = f"the pose is up to {oldest_ms / 1e3:.1f} s old"
        yield Finding("stale_pose", whole, reason, oldest_ms, limit_ms, "ms")


FRAME_RULES = (
    find_blurred,
    find_dark,
    find_overexposed,
    find_dropouts,
    find_clock_steps,
    find_stale_poses,
)
