"""Rules about lines in the image. They need no poses and no spans."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from inspect_pipeline.inspection.anomalies.frames import Finding
from inspect_pipeline.inspection.anomalies.jumps import find_orientation_jumps
from inspect_pipeline.inspection.lines import confirmed_lines
from inspect_pipeline.inspection.rows import NO_TRACK

if TYPE_CHECKING:
    from collections.abc import Iterator

    from inspect_pipeline.arrays import Floats
    from inspect_pipeline.inspection.rows import CameraRows, FrameQuality, LineRows
    from inspect_pipeline.inspection.rules import Rules


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


LINE_RULES = (find_crossings, find_orientation_jumps)
