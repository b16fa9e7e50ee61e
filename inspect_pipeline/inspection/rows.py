"""Frames and lines of a flight as columns, one set for each camera."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from inspect_pipeline.inspection.cadence import measure_cadence

if TYPE_CHECKING:
    from inspect_pipeline.arrays import Floats, Ints, Mask
    from inspect_pipeline.inspection.cadence import Cadence
    from inspect_pipeline.inspection.rules import Rules


NO_TRACK = -1


@dataclass(frozen=True)
class FrameRows:
    """Frames of a camera in order, one array (N,) per column. NaN for NULL, -1 for a NULL size.

    is_turn_known: whether the attitude of the camera was recorded and not assumed. rise_m: of the ground
    below, by a terrain model; ground_lat_deg, ground_lon_deg: where the optical axis meets the ground.
    """

    frame_idx: Ints
    log_time_ns: Ints
    stamp_ns: Ints
    width: Ints
    height: Ints
    is_ok: Mask
    sharpness: Floats
    mean_luma: Floats
    lat_deg: Floats
    lon_deg: Floats
    height_m: Floats
    cam_yaw_deg: Floats
    cam_pitch_deg: Floats
    cam_roll_deg: Floats
    pose_age_ms: Floats
    focal_px: Floats
    gsd_m: Floats
    ground_lat_deg: Floats
    ground_lon_deg: Floats
    rise_m: Floats
    is_turn_known: Mask

    def __len__(self) -> int:
        return len(self.frame_idx)

    @cached_property
    def times_s(self) -> Floats:
        """Seconds since the first frame (N,)."""
        return (self.log_time_ns - self.log_time_ns[:1]) / 1e9


@dataclass(frozen=True)
class LineRows:
    """Lines of a camera, ordered by frame.

    frame (M,): row of the frame. track (M,): track id or NO_TRACK. points (P, 2) px: the points of all lines,
    those of line i at first[i] : first[i + 1]. source_frame (M,): row of the frame in which the line was
    detected, where that may differ from `frame`.
    """

    frame: Ints
    track: Ints
    first: Ints
    points: Floats
    source_frame: Ints | None = None

    def __len__(self) -> int:
        return len(self.frame)

    @cached_property
    def chords(self) -> Floats:
        """First and last points (M, 2, 2)."""
        return np.stack((self.points[self.first[:-1]], self.points[self.first[1:] - 1]), axis=1)

    @property
    def detected_in(self) -> Ints:
        """Rows (M,) of the frames in which the lines were detected."""
        return self.frame if self.source_frame is None else self.source_frame

    def take(self, chosen: Ints) -> LineRows:
        """Return lines by index, in the given order."""
        counts = np.diff(self.first)[chosen]
        return LineRows(
            self.frame[chosen],
            self.track[chosen],
            np.concatenate(([0], np.cumsum(counts))).astype(np.int64),
            self.points[np.repeat(self.first[chosen], counts) + count_up(counts)],
            None if self.source_frame is None else self.source_frame[chosen],
        )

    def in_frames(self, start: int, stop: int) -> LineRows:
        """Return the lines of the frames start <= frame < stop."""
        low, high = np.searchsorted(self.frame, (start, stop)).tolist()
        return self.take(np.arange(low, high))

    def with_frames(self, frame: Ints) -> LineRows:
        """Return the same lines with other frame rows."""
        return replace(self, frame=frame, source_frame=None)

    def shift_frames(self, offset: int) -> LineRows:
        """Return the same lines with `offset` added to their frame rows."""
        source = None if self.source_frame is None else self.source_frame + offset
        return replace(self, frame=self.frame + offset, source_frame=source)


@dataclass(frozen=True)
class CameraRows:
    """Frames and lines of one camera. is_stills: photographs, between which pauses are no faults."""

    channel_id: int
    frames: FrameRows
    lines: LineRows
    is_stills: bool = False

    def cadence(self, rules: Rules) -> Cadence:
        """Estimate the cadence of the frames."""
        return measure_cadence(self.frames.times_s, rules, is_stills=self.is_stills)


@dataclass(frozen=True)
class FrameQuality:
    """Masks (N,) of the usable frames of a camera, and of the reasons against the others."""

    usable: Mask
    blurred: Mask
    dark: Mask
    overexposed: Mask


def assess_frames(frames: FrameRows, rules: Rules) -> FrameQuality:
    """Find blurred, dark and overexposed frames by the thresholds of [frames]."""
    limits = rules.frames
    dark = frames.is_ok & (frames.mean_luma < limits["dark_below_luma"])
    overexposed = frames.is_ok & (frames.mean_luma > limits["overexposed_above_luma"])
    exposed = frames.is_ok & ~dark & ~overexposed
    sharpness = frames.sharpness[exposed]
    median = np.nanmedian(sharpness) if np.isfinite(sharpness).any() else np.nan
    blurred = exposed & (frames.sharpness < limits["blurred_below"] * median)
    return FrameQuality(exposed & ~blurred, blurred, dark, overexposed)


def find_runs(mask: Mask, min_length: float) -> list[Ints]:
    """Return the indices of each run of True of at least `min_length`."""
    edges = np.flatnonzero(np.diff(mask.astype(np.int8), prepend=0, append=0)).reshape(-1, 2)
    return [np.arange(first, stop) for first, stop in edges.tolist() if stop - first >= min_length]


def count_up(counts: Ints) -> Ints:
    """Return 0, 1, ... count - 1 for each count, concatenated."""
    return np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
