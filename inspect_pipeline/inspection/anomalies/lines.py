"""Rules about lines in the image. They need no poses and no spans."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from inspect_pipeline.geometry.camera import camera_axes
from inspect_pipeline.inspection.anomalies.frames import Finding
from inspect_pipeline.inspection.lines import confirmed_lines
from inspect_pipeline.inspection.rows import NO_TRACK

if TYPE_CHECKING:
    from collections.abc import Iterator

    from inspect_pipeline.arrays import Floats, Ints, Mask
    from inspect_pipeline.inspection.rows import CameraRows, FrameQuality, FrameRows, LineRows
    from inspect_pipeline.inspection.rules import Rules


_SAME_OFFSET_PX, _SAME_ANGLE_DEG = 25.0, 4.0  # between a rotated line and its match
_MAX_PAUSE_FRAMES = 2


def find_crossings(camera: CameraRows, quality: FrameQuality, rules: Rules) -> Iterator[Finding]:
    """Find tracks at an angle to most of the line length in their frames: where no span is near."""
    limits, lines = rules.of("crossing_line"), confirmed_lines(camera.lines, rules)
    if not len(lines) or not np.any(lines.track != NO_TRACK):
        return
    across_deg = _angles_to_others(camera, lines)
    is_crossing = (across_deg >= limits["min_angle_deg"]) & quality.usable[lines.frame]
    for track in np.unique(lines.track[is_crossing]):
        own = lines.track == track
        hits = own & is_crossing
        rows = np.unique(lines.frame[hits])
        is_steady = len(rows) >= limits["min_share"] * (rows[-1] - rows[0] + 1)
        if len(rows) >= limits["min_track_frames"] and is_steady and hits.sum() > own.sum() / 2:
            angle_deg = float(np.median(across_deg[hits]))
            reason = f"a line at {angle_deg:.0f} degrees to the others, over {len(rows)} frames"
            limit = limits["min_angle_deg"]
            yield Finding("crossing_line", rows, reason, angle_deg, limit, "deg", int(track))


def _angles_to_others(camera: CameraRows, lines: LineRows) -> Floats:
    """Return degrees (M,), 0 to 90, between a line and the main direction of the others in its frame."""
    runs = lines.chords[:, 1] - lines.chords[:, 0]
    length_px = np.hypot(runs[:, 0], runs[:, 1])
    angle = np.arctan2(runs[:, 1], runs[:, 0])
    doubled = length_px * np.exp(2j * angle)
    sums = np.bincount(lines.frame, doubled.real, len(camera.frames)) + 1j * np.bincount(
        lines.frame, doubled.imag, len(camera.frames)
    )
    others = sums[lines.frame] - doubled
    between = np.abs(np.angle(np.exp(2j * angle) * np.conj(others))) / 2
    between[np.abs(others) < length_px] = 0.0  # no other lines, or of no common direction
    degrees: Floats = np.degrees(between)
    return degrees


def find_orientation_jumps(camera: CameraRows, quality: FrameQuality, rules: Rules) -> Iterator[Finding]:
    """Find frames whose lines are those of the previous frame, rotated about the image centre."""
    if not camera.cadence(rules).is_video:
        return
    limits, lines, frames = rules.of("orientation_jump"), camera.lines, camera.frames
    offsets, angles = _normal_forms(camera)
    bounds = np.searchsorted(lines.frame, np.arange(len(frames) + 1))
    rows = np.flatnonzero(quality.usable)
    turned_deg = _recorded_turns(frames, rows)
    for before, after, own_deg in zip(rows[:-1].tolist(), rows[1:].tolist(), turned_deg, strict=True):
        if after - before > _MAX_PAUSE_FRAMES or own_deg >= limits["min_jump_deg"] / 2:
            continue
        a, b = (slice(bounds[row], bounds[row + 1]) for row in (before, after))
        turn_deg, n_turned, n_kept = _best_turn(offsets[a], angles[a], offsets[b], angles[b])
        least = max(limits["min_lines"], limits["min_share"] * max(a.stop - a.start, b.stop - b.start))
        if abs(turn_deg) >= limits["min_jump_deg"] and n_turned >= least and n_turned > n_kept:
            reason = f"{n_turned} lines rotate by {turn_deg:+.0f} degrees from one frame to the next"
            shown = np.array([before, after])
            limit = limits["min_jump_deg"]
            yield Finding("orientation_jump", shown, reason, abs(turn_deg), limit, "deg")


def _recorded_turns(frames: FrameRows, rows: Ints) -> list[float]:
    """Return by how many degrees the recorded attitude turned between frames (N - 1), 0 where unknown."""
    turns = np.column_stack((frames.cam_yaw_deg, frames.cam_pitch_deg, frames.cam_roll_deg))[rows]
    axes = camera_axes(np.nan_to_num(turns))
    cosines = (np.einsum("nij,nij->n", axes[:-1], axes[1:]) - 1) / 2
    known = np.isfinite(turns).all(axis=1) & frames.is_turn_known[rows]
    degrees = np.degrees(np.arccos(np.clip(cosines, -1, 1)))
    return [float(one) for one in np.where(known[:-1] & known[1:], degrees, 0.0)]


def _normal_forms(camera: CameraRows) -> tuple[Floats, Floats]:
    """Return signed px (M,) from the image centre to each line, and its angle in [0, 180) (M,)."""
    frames, lines = camera.frames, camera.lines
    middles = np.column_stack((frames.width, frames.height))[lines.frame] / 2
    begin, end = (lines.chords[:, i] - middles for i in (0, 1))
    angle = np.arctan2(end[:, 1] - begin[:, 1], end[:, 0] - begin[:, 0]) % np.pi
    offset = begin[:, 0] * np.sin(angle) - begin[:, 1] * np.cos(angle)
    return offset, np.degrees(angle)


def _best_turn(
    offsets: Floats, angles: Floats, next_offsets: Floats, next_angles: Floats
) -> tuple[float, int, int]:
    """Return the rotation in degrees of most lines, their number, and the number of lines that stay."""
    turns = (next_angles[np.newaxis] - angles[:, np.newaxis] + 90) % 180 - 90
    # The offset of a line that rotates past 180 degrees changes its sign.
    wraps = np.round((angles[:, np.newaxis] + turns - next_angles[np.newaxis]) / 180).astype(int) % 2
    away = np.abs(offsets[:, np.newaxis] - np.where(wraps == 1, -1, 1) * next_offsets[np.newaxis])
    near = away <= _SAME_OFFSET_PX
    candidates = turns[near]
    if not len(candidates):
        return 0.0, 0, 0
    agree = np.abs(candidates[:, np.newaxis] - candidates[np.newaxis]) <= _SAME_ANGLE_DEG
    best = int(np.argmax(agree.sum(axis=1)))
    turn_deg = float(np.median(candidates[agree[best]]))
    return turn_deg, _count_pairs(near, turns, turn_deg), _count_pairs(near, turns, 0.0)


def _count_pairs(near: Mask, turns: Floats, turn_deg: float) -> int:
    """Count the lines of one frame that have a match in the other after a rotation."""
    fits = near & (np.abs(turns - turn_deg) <= _SAME_ANGLE_DEG)
    return int(min(fits.any(axis=0).sum(), fits.any(axis=1).sum()))


LINE_RULES = (find_crossings, find_orientation_jumps)
