"""Camera poses of frames in local metres, and what is unknown about them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from inspect_pipeline.geometry.camera import CameraPoses, camera_axes
from inspect_pipeline.geometry.local_frame import LocalMetres

if TYPE_CHECKING:
    from collections.abc import Sequence

    from inspect_pipeline.arrays import Floats, Ints, Mask
    from inspect_pipeline.inspection.rows import CameraRows, FrameRows
    from inspect_pipeline.inspection.rules import Rules

POSE_PROBLEMS = (
    "frame unusable",
    "pose too old",
    "camera attitude unknown",
    "lens unknown",
    "height above ground unknown",
    "position unknown",
)
NO_PROBLEM = -1
_MIN_NOISE_M, _MEDIAN_TO_SD = 0.3, 0.826  # of single positions; of the middle of three, 0.6745 * sqrt(1.5)
_HALF_WINDOW_S, _MIN_SMOOTHED = 4.0, 5


def camera_poses(frames: FrameRows, origin: LocalMetres, rules: Rules) -> CameraPoses:
    """Return the poses of all frames, with NaN positions where attitude is assumed or the pose too old.

    Heights are above the ground below the first position of the flight, if a terrain model was there.
    """
    is_old = ~frames.is_turn_known | (frames.pose_age_ms > rules.coverage["max_pose_age_ms"])
    ground = origin.to_metres(frames.lat_deg, frames.lon_deg)
    heights_m = frames.height_m + np.nan_to_num(frames.rise_m)
    positions = smooth_positions(np.column_stack((ground, heights_m)), frames.times_s)
    positions[is_old] = np.nan
    return CameraPoses(
        positions=positions,
        axes=camera_axes(np.column_stack((frames.cam_yaw_deg, frames.cam_pitch_deg, frames.cam_roll_deg))),
        focal_px=frames.focal_px.astype(np.float64),
        sizes=np.column_stack((frames.width, frames.height)).astype(np.float64),
    )


def smooth_positions(positions: Floats, times_s: Floats) -> Floats:
    """Return positions (N, 3) without the white noise of single fixes, where there is evidently much of it.

    The noise is measured between neighbours in time, which a drone cannot reach by flying. Each position
    becomes that of a parabola fitted to those of some seconds around it.
    """
    known = np.flatnonzero(np.isfinite(positions).all(axis=1))
    smooth = positions.copy()
    if len(known) < _MIN_SMOOTHED:
        return smooth
    t, p = times_s[known], positions[known]
    before, after = t[1:-1] - t[:-2], t[2:] - t[1:-1]
    share = before / np.maximum(before + after, 1e-9)
    off_m = p[1:-1] - (p[:-2] + share[:, np.newaxis] * (p[2:] - p[:-2]))
    noise_m = np.median(np.abs(off_m), axis=0) / _MEDIAN_TO_SD
    if noise_m.max() < _MIN_NOISE_M:
        return smooth
    half_s = max(_HALF_WINDOW_S, _MIN_SMOOTHED * float(np.median(np.diff(t))) / 2)
    first, stop = np.searchsorted(t, t - half_s), np.searchsorted(t, t + half_s, side="right")
    for i, (low, high) in enumerate(zip(first.tolist(), stop.tolist(), strict=True)):
        if high - low >= _MIN_SMOOTHED:
            smooth[known[i]] = np.polynomial.polynomial.polyfit(t[low:high] - t[i], p[low:high], 2)[0]
    return smooth


def find_pose_problems(frames: FrameRows, is_usable: Mask, rules: Rules) -> Ints:
    """Return the index (N,) in POSE_PROBLEMS of why a frame cannot be used on spans, or NO_PROBLEM."""
    turns = (frames.cam_yaw_deg, frames.cam_pitch_deg, frames.cam_roll_deg)
    by_priority = (
        ~np.isfinite(frames.lat_deg) | ~np.isfinite(frames.lon_deg),
        ~np.isfinite(frames.height_m),
        # A frame that was not decoded has no lens either.
        ~np.isfinite(frames.focal_px) & frames.is_ok,
        ~frames.is_turn_known | ~np.isfinite(np.stack(turns)).all(axis=0),
        frames.pose_age_ms > rules.coverage["max_pose_age_ms"],
        ~is_usable,
    )
    problems = np.full(len(frames), NO_PROBLEM, np.int64)
    for number, mask in enumerate(reversed(by_priority)):
        problems[mask] = number
    return problems


def commonest_problem(problems: Ints) -> str | None:
    """Return the most frequent problem of some frames, None when there is none."""
    known = problems[problems != NO_PROBLEM]
    return POSE_PROBLEMS[int(np.bincount(known).argmax())] if len(known) else None


def distance_flown_m(frames: FrameRows) -> Floats:
    """Return metres flown since the first position (N,); NaN before it, and without positions."""
    known = np.flatnonzero(np.isfinite(frames.lat_deg) & np.isfinite(frames.lon_deg))
    distance = np.full(len(frames), np.nan)
    if len(known):
        origin = LocalMetres(frames.lat_deg[known[0]], frames.lon_deg[known[0]])
        positions = origin.to_metres(frames.lat_deg[known], frames.lon_deg[known])
        steps = np.hypot(*np.diff(positions, axis=0).T)
        flown = np.concatenate(([0.0], np.cumsum(steps)))
        distance[known[0] :] = np.interp(np.arange(known[0], len(frames)), known, flown)
    return distance


def find_origin(cameras: Sequence[CameraRows]) -> LocalMetres | None:
    """Return a local frame at the first known position of a flight."""
    for camera in cameras:
        known = np.flatnonzero(np.isfinite(camera.frames.lat_deg) & np.isfinite(camera.frames.lon_deg))
        if len(known):
            return LocalMetres(camera.frames.lat_deg[known[0]], camera.frames.lon_deg[known[0]])
    return None
