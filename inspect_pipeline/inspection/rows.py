"""What coverage and anomalies are computed from: the rows of a flight as columns, camera by camera."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from inspect_pipeline.geometry.camera import CameraPoses, camera_axes
from inspect_pipeline.geometry.local_frame import LocalMetres

if TYPE_CHECKING:
    from collections.abc import Sequence

    from inspect_pipeline.arrays import Floats, Ints, Mask
    from inspect_pipeline.inspection.rules import Rules


NO_TRACK = -1


@dataclass(frozen=True)
class FrameRows:
    """The frames of a camera in order, an array (N,) for each column; NaN for NULL, -1 for a size of NULL.

    is_turn_known: whether the camera's attitude was recorded, instead of assumed.
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
    is_turn_known: Mask

    def __len__(self) -> int:
        return len(self.frame_idx)

    @cached_property
    def times_s(self) -> Floats:
        """Since the first frame."""
        return (self.log_time_ns - self.log_time_ns[:1]) / 1e9

    @cached_property
    def period_s(self) -> float:
        """The median interval; NaN with less than two frames."""
        return float(np.median(np.diff(self.times_s))) if len(self) > 1 else float("nan")


@dataclass(frozen=True)
class LineRows:
    """The lines of a camera, ordered by frame.

    frame (M,) is the row of its frame, track (M,) its track or NO_TRACK. points (P, 2) px are those of all
    lines one after the other; those of line i are points[first[i] : first[i + 1]]. taken_from (M,) is the row
    of the frame whose picture has the line, None where it is always `frame`.
    """

    frame: Ints
    track: Ints
    first: Ints
    points: Floats
    taken_from: Ints | None = None

    def __len__(self) -> int:
        return len(self.frame)

    @cached_property
    def chords(self) -> Floats:
        """(M, 2, 2): the first and the last point."""
        return np.stack((self.points[self.first[:-1]], self.points[self.first[1:] - 1]), axis=1)

    @property
    def picture(self) -> Ints:
        """(M,) the rows of the frames whose pictures have the lines."""
        return self.frame if self.taken_from is None else self.taken_from

    def select(self, chosen: Mask) -> LineRows:
        """Some of the lines."""
        counts = np.diff(self.first)
        return LineRows(
            self.frame[chosen],
            self.track[chosen],
            np.concatenate(([0], np.cumsum(counts[chosen]))).astype(np.int64),
            self.points[np.repeat(chosen, counts)],
        )

    def of_frames(self, first: int, stop: int) -> LineRows:
        """The lines of the frames first <= frame < stop."""
        low, high = np.searchsorted(self.frame, (first, stop)).tolist()
        at = self.first[low : high + 1]
        taken = None if self.taken_from is None else self.taken_from[low:high]
        points = self.points[at[0] : at[-1]]
        return LineRows(self.frame[low:high], self.track[low:high], at - at[0], points, taken)

    def counted_from(self, row: int) -> LineRows:
        """The same lines, with frames numbered from a row."""
        taken = None if self.taken_from is None else self.taken_from - row
        return replace(self, frame=self.frame - row, taken_from=taken)


@dataclass(frozen=True)
class CameraRows:
    """The frames and lines of one camera of a flight.

    is_stills: photographs, whose pauses, turns and stamps say nothing of a fault.
    """

    channel_id: int
    frames: FrameRows
    lines: LineRows
    is_stills: bool = False


@dataclass(frozen=True)
class Usable:
    """Which frames of a camera can be used, and what is wrong with the others: masks (N,)."""

    usable: Mask
    blurred: Mask
    dark: Mask
    overexposed: Mask


def judge_frames(frames: FrameRows, rules: Rules) -> Usable:
    """Which frames are bad, blurred, dark or overexposed by the thresholds of [frames]."""
    limits = rules.frames
    dark = frames.is_ok & (frames.mean_luma < limits["dark_below_luma"])
    overexposed = frames.is_ok & (frames.mean_luma > limits["overexposed_above_luma"])
    good = frames.is_ok & ~dark & ~overexposed
    usual = np.nanmedian(frames.sharpness[good]) if np.isfinite(frames.sharpness[good]).any() else np.nan
    blurred = good & (frames.sharpness < limits["blurred_below"] * usual)
    return Usable(good & ~blurred, blurred, dark, overexposed)


def tracked_lines(lines: LineRows, rules: Rules) -> LineRows:
    """The lines of tracks that are long enough; all lines where none was followed."""
    if not np.any(lines.track != NO_TRACK):
        return lines
    tracks, inverse, counts = np.unique(lines.track, return_inverse=True, return_counts=True)
    is_long = (counts >= rules.tracks["min_frames"]) & (tracks != NO_TRACK)
    return lines.select(is_long[inverse])


def completed_lines(lines: LineRows, max_missed: float) -> LineRows:
    """The lines, and for up to `max_missed` frames that lack one amid its track, those of the frame before.

    Lines without a track are left out.
    """
    order = np.lexsort((lines.frame, lines.track))
    order = order[lines.track[order] != NO_TRACK]
    if not len(order):
        return lines.select(np.zeros(len(lines), bool))
    frame, track = lines.frame[order], lines.track[order]
    # Several lines may be pieces of one track in one frame: they go together, as a sight.
    begins = np.flatnonzero((np.diff(frame, prepend=-1) != 0) | (np.diff(track, prepend=track[0] - 1) != 0))
    sizes = np.diff(begins, append=len(order))
    steps = np.append(np.diff(frame[begins]), 1)
    is_bridged = np.append(np.diff(track[begins]) == 0, False) & (steps <= max_missed + 1)
    repeats = np.where(is_bridged, steps, 1)
    sight = np.repeat(np.arange(len(begins)), repeats)
    age = _count_up(repeats)
    taken = np.repeat(begins[sight], sizes[sight]) + _count_up(sizes[sight])
    frames = np.repeat(frame[begins][sight] + age, sizes[sight])
    by_frame = np.argsort(frames, kind="stable")
    return _take(lines, order[taken][by_frame], frames[by_frame])


def _count_up(counts: Ints) -> Ints:
    """0, 1, ... of each count, one after the other."""
    return np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)


def _take(lines: LineRows, chosen: Ints, frames: Ints) -> LineRows:
    """Lines by their numbers, as lines of other frames."""
    counts = np.diff(lines.first)[chosen]
    first = np.concatenate(([0], np.cumsum(counts))).astype(np.int64)
    points = lines.points[np.repeat(lines.first[chosen], counts) + _count_up(counts)]
    return LineRows(frames, lines.track[chosen], first, points, lines.frame[chosen])


def place_cameras(frames: FrameRows, origin: LocalMetres, rules: Rules) -> CameraPoses:
    """The cameras of frames; NaN where the pose or the lens is not known, is assumed, or the pose too old."""
    is_old = ~frames.is_turn_known | (frames.pose_age_ms > rules.coverage["max_pose_age_ms"])
    ground = origin.to_metres(frames.lat_deg, frames.lon_deg)
    positions = np.column_stack((ground, frames.height_m))
    positions[is_old] = np.nan
    return CameraPoses(
        positions=positions,
        axes=camera_axes(np.column_stack((frames.cam_yaw_deg, frames.cam_pitch_deg, frames.cam_roll_deg))),
        focal_px=frames.focal_px.astype(np.float64),
        sizes=np.column_stack((frames.width, frames.height)).astype(np.float64),
    )


def path_metres(frames: FrameRows) -> Floats:
    """(N,) metres flown since the first frame with a position; NaN before it and without any."""
    known = np.flatnonzero(np.isfinite(frames.lat_deg) & np.isfinite(frames.lon_deg))
    walked = np.full(len(frames), np.nan)
    if len(known):
        origin = LocalMetres(frames.lat_deg[known[0]], frames.lon_deg[known[0]])
        places = origin.to_metres(frames.lat_deg[known], frames.lon_deg[known])
        steps = np.hypot(*np.diff(places, axis=0).T)
        so_far = np.concatenate(([0.0], np.cumsum(steps)))
        walked[known[0] :] = np.interp(np.arange(known[0], len(frames)), known, so_far)
    return walked


def find_origin(cameras: Sequence[CameraRows]) -> LocalMetres | None:
    """The first known position of a flight."""
    for camera in cameras:
        known = np.flatnonzero(np.isfinite(camera.frames.lat_deg) & np.isfinite(camera.frames.lon_deg))
        if len(known):
            return LocalMetres(camera.frames.lat_deg[known[0]], camera.frames.lon_deg[known[0]])
    return None


def runs_of(mask: Mask, min_length: float) -> list[Ints]:
    """The rows of each run of True that is long enough."""
    edges = np.flatnonzero(np.diff(mask.astype(np.int8), prepend=0, append=0)).reshape(-1, 2)
    return [np.arange(first, stop) for first, stop in edges.tolist() if stop - first >= min_length]
