"""Rule about cameras that turn in their mount, which no message records: all lines rotate at once.

Lines of one frame are compared with where they should appear in the next one by the recorded poses, if they
hang as high as conductors usually do. So a drone may turn, or circle a pole, however few frames a second.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from inspect_pipeline.inspection.anomalies.frames import Finding
from inspect_pipeline.inspection.poses import camera_poses, find_origin

if TYPE_CHECKING:
    from collections.abc import Iterator

    from inspect_pipeline.arrays import Floats, Mask
    from inspect_pipeline.geometry.camera import CameraPoses
    from inspect_pipeline.inspection.rows import CameraRows, FrameQuality
    from inspect_pipeline.inspection.rules import Rules

_SAME_OFFSET, _SAME_ANGLE_DEG = 0.03, 4.0  # between a rotated line and its match; of the longer image side
_MIN_MORE = 2  # lines that rotate than lines that stay: a shift makes one of either
_MAX_SHIFT = 0.15  # of all lines of a frame, by errors of positions; of the longer image side
_MAX_PAUSE_FRAMES = 2
_MIN_DEPTH_M = 0.5
_FAR_M = 1e4  # of lines that are not below the camera: only its turns move them


def find_orientation_jumps(camera: CameraRows, quality: FrameQuality, rules: Rules) -> Iterator[Finding]:
    """Find frames whose lines are those of the previous frame, rotated about the image centre."""
    if not camera.cadence(rules).is_video:
        return
    limits, lines, frames = rules.of("orientation_jump"), camera.lines, camera.frames
    bounds = np.searchsorted(lines.frame, np.arange(len(frames) + 1))
    rows = np.flatnonzero(quality.usable)
    origin = find_origin([camera])
    cameras = camera_poses(frames, origin, rules) if origin else None
    height_m = rules.coverage["default_height_m"]
    for before, after in zip(rows[:-1].tolist(), rows[1:].tolist(), strict=True):
        if after - before > _MAX_PAUSE_FRAMES:
            continue
        a, b = (lines.chords[bounds[row] : bounds[row + 1]] for row in (before, after))
        size = np.array((frames.width[after], frames.height[after]), np.float64)
        if cameras is not None:
            a = _appear_next(cameras, before, after, a, height_m)
        turn_deg, n_turned, n_kept = _best_turn(_normal_form(a, size), _normal_form(b, size), size.max())
        least = max(limits["min_lines"], limits["min_share"] * max(len(a), len(b)))
        if abs(turn_deg) >= limits["min_jump_deg"] and n_turned >= least and n_turned >= n_kept + _MIN_MORE:
            reason = f"{n_turned} lines rotate by {turn_deg:+.0f} degrees from one frame to the next"
            shown = np.array([before, after])
            limit = limits["min_jump_deg"]
            yield Finding("orientation_jump", shown, reason, abs(turn_deg), limit, "deg")


def _appear_next(cameras: CameraPoses, before: int, after: int, chords: Floats, height_m: float) -> Floats:
    """Return where chords (M, 2, 2) of one frame should appear in another, unchanged if poses are unknown."""
    pair = cameras[np.array([before, after])]
    if not np.isfinite(pair.positions).all():
        pair, height_m = replace(pair, positions=np.zeros((2, 3))), np.inf  # only the turn is known
    pixels = chords.reshape(-1, 2)
    rays = pair.rays(np.zeros(len(pixels), int), pixels)
    with np.errstate(divide="ignore", invalid="ignore"):
        reach_m = (height_m - pair.positions[0, 2]) / rays[:, 2]
    reach_m[~((reach_m > 0) & (reach_m < _FAR_M))] = _FAR_M
    (moved,), (depths_m,) = pair[1:].project(pair.positions[0] + reach_m[:, np.newaxis] * rays)
    if not np.isfinite(moved).all():
        return chords
    is_seen = depths_m > _MIN_DEPTH_M
    return np.asarray(moved.reshape(chords.shape)[is_seen.reshape(-1, 2).all(axis=1)])


def _normal_form(chords: Floats, size: Floats) -> tuple[Floats, Floats]:
    """Return signed px (M,) from the image centre to each line, and its angle in [0, 180) (M,)."""
    begin, end = chords[:, 0] - size / 2, chords[:, 1] - size / 2
    angle = np.arctan2(end[:, 1] - begin[:, 1], end[:, 0] - begin[:, 0]) % np.pi
    offset = begin[:, 0] * np.sin(angle) - begin[:, 1] * np.cos(angle)
    return offset, np.degrees(angle)


def _best_turn(
    first: tuple[Floats, Floats], second: tuple[Floats, Floats], longer_px: float
) -> tuple[float, int, int]:
    """Return the rotation in degrees of most lines, their number, and the number of lines that stay.

    No rotation where not clearly more lines rotate than stay. Errors of positions shift all lines of a frame
    alike, whether they rotate or stay. Rotations that cannot fit more lines than a known one are not tried.
    """
    (offsets, angles), (next_offsets, next_angles) = first, second
    turns = (next_angles[np.newaxis] - angles[:, np.newaxis] + 90) % 180 - 90
    # The offset of a line that rotates past 180 degrees changes its sign.
    wraps = np.round((angles[:, np.newaxis] + turns - next_angles[np.newaxis]) / 180).astype(int) % 2
    away = next_offsets[np.newaxis] - np.where(wraps == 1, -1, 1) * offsets[:, np.newaxis]
    is_near = np.abs(away) <= _MAX_SHIFT * longer_px
    if not is_near.any():
        return 0.0, 0, 0
    radians = np.radians(next_angles)
    normals = np.column_stack((np.sin(radians), -np.cos(radians)))
    shifts = np.append(np.zeros((1, 2)), (away[..., np.newaxis] * normals)[is_near], axis=0)

    is_in_reach = np.abs(away) <= (_MAX_SHIFT + _SAME_OFFSET) * longer_px

    def fits(turn_deg: float) -> Mask:
        return np.asarray(is_in_reach & (np.abs(turns - turn_deg) <= _SAME_ANGLE_DEG))

    n_kept = _count_pairs(away, shifts, normals, fits(0.0), _SAME_OFFSET * longer_px)
    best, n_turned = -1, n_kept + _MIN_MORE - 1
    candidates = turns[is_near].tolist() if n_turned < min(turns.shape) else []
    at_most = [min(fits(turn_deg).any(axis=k).sum() for k in (0, 1)) for turn_deg in candidates]
    for i in sorted(range(len(candidates)), key=lambda i: -at_most[i]):
        if at_most[i] < n_turned:
            break
        found = _count_pairs(away, shifts, normals, fits(candidates[i]), _SAME_OFFSET * longer_px)
        if (found, -i) > (n_turned, -best):
            best, n_turned = i, found
    return (candidates[best], n_turned, n_kept) if best >= 0 else (0.0, n_kept, n_kept)


def _count_pairs(away: Floats, shifts: Floats, normals: Floats, fits: Mask, near_px: float) -> int:
    """Count the lines of one frame that have a match in the other, after the shift (S, 2) that gives most."""
    first, second = np.nonzero(fits)
    left = np.abs(away[fits] - shifts @ normals[second].T)  # (S, Q) of the pairs that fit
    same = np.asarray(left <= near_px, np.float32)
    counts = [
        np.count_nonzero(same @ np.eye(n, dtype=np.float32)[of] > 0, axis=1)
        for n, of in zip(fits.shape, (first, second), strict=True)
    ]
    return int(np.minimum(*counts).max())
