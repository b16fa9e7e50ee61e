"""Coverage of spans, and of the ground below the path, in bins of about a metre."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from inspect_pipeline.inspection.coverage.frames import has_lines
from inspect_pipeline.inspection.coverage.rows import Bins
from inspect_pipeline.inspection.lines import confirmed_lines
from inspect_pipeline.inspection.poses import (
    NO_PROBLEM,
    camera_poses,
    commonest_problem,
    distance_flown_m,
    find_pose_problems,
)
from inspect_pipeline.inspection.rows import assess_frames
from inspect_pipeline.inspection.span_view import (
    make_axis,
    near_path,
    select_frames,
    view_span,
    visible_gsd_m,
)
from inspect_pipeline.inspection.terrain import find_ground

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from inspect_pipeline.arrays import Floats, Ints, Mask
    from inspect_pipeline.geometry.camera import CameraPoses
    from inspect_pipeline.geometry.local_frame import LocalMetres
    from inspect_pipeline.inspection.rows import CameraRows, FrameRows, LineRows
    from inspect_pipeline.inspection.rules import Rules
    from inspect_pipeline.inspection.spans import Span


_FRAMES_AT_A_TIME = 64
_MAX_BINS = 100_000  # of a path: 100 km by the shipped rules


@dataclass(frozen=True, slots=True, eq=False)
class _Camera:
    """A camera with the poses of its usable frames, and positions (K, 2) where it had none, and why."""

    rows: CameraRows
    poses: CameraPoses
    lines: LineRows
    path: Floats
    blind_path: Floats
    problems: Ints


def span_bins(
    cameras: Sequence[CameraRows], spans: Sequence[Span], origin: LocalMetres, rules: Rules
) -> Iterator[Bins]:
    """Yield the bins of each span near the path."""
    known = [_place_camera(camera, origin, rules) for camera in cameras]
    path = np.concatenate([camera.path for camera in known])
    near_m, ground = rules.coverage["near_m"], find_ground(cameras, origin)
    for span in spans:
        axis = make_axis(span, origin, rules, ground)
        passed = near_path(axis.centres[:, :2], path, near_m)
        if not passed.any():
            continue
        counts = _BinCounts(len(axis.centres))
        for camera in known:
            frames = select_frames(axis.centres, camera.poses, camera.lines)
            view = view_span(axis, frames.cameras, frames.lines, rules)
            gsd_m = _fine_only(view.gsd_m, rules)
            hit = np.zeros(gsd_m.shape, bool)
            hit[view.frame, view.bin] = True
            counts.add(np.arange(len(axis.centres)), gsd_m, hit, camera.rows.frames.log_time_ns[frames.rows])
            counts.add_unknown(near_path(axis.centres[:, :2], camera.blind_path, near_m), camera.problems)
        bins = counts.to_bins("span", axis.centres, axis.bin_m, origin)
        yield replace(bins, span_id=span.span_id, passed_m=float(passed.sum()) * axis.bin_m)


def corridor_bins(cameras: Sequence[CameraRows], origin: LocalMetres, rules: Rules) -> Iterator[Bins]:
    """Yield the bins of the ground below the path of the first camera with positions."""
    flown = next(c.frames for c in cameras if np.isfinite(c.frames.lat_deg).any())
    centres, bin_m = _divide_path(flown, origin, rules.coverage["bin_m"])
    if not len(centres):
        return
    centres[:, 2] = find_ground(cameras, origin).at(centres[:, :2])
    counts = _BinCounts(len(centres))
    for rows in cameras:
        camera, found = _place_camera(rows, origin, rules), has_lines(rows, rules)
        for start in range(0, len(found), _FRAMES_AT_A_TIME):
            chunk = slice(start, start + _FRAMES_AT_A_TIME)
            bins = _within_reach(centres, camera.poses[chunk], rules)
            gsd_m = _fine_only(visible_gsd_m(camera.poses[chunk], centres[bins]), rules)
            hit = np.isfinite(gsd_m) & found[chunk, np.newaxis]
            counts.add(bins, gsd_m, hit, rows.frames.log_time_ns[chunk])
        blind = near_path(centres[:, :2], camera.blind_path, rules.coverage["near_m"])
        counts.add_unknown(blind, camera.problems)
    yield counts.to_bins("corridor", centres, bin_m, origin)


def _place_camera(camera: CameraRows, origin: LocalMetres, rules: Rules) -> _Camera:
    """Return the poses of a camera, without those of unusable frames."""
    frames = camera.frames
    usable = assess_frames(frames, rules).usable
    poses = camera_poses(frames, origin, rules)
    poses.positions[~usable] = np.nan
    path = origin.to_metres(frames.lat_deg, frames.lon_deg)
    known = np.isfinite(path).all(axis=1)
    # A frame that is unusable shows nothing, which is known.
    problems = find_pose_problems(frames, np.ones(len(frames), bool), rules)
    blind = known & (problems != NO_PROBLEM) & usable
    lines = confirmed_lines(camera.lines, rules)
    return _Camera(camera, poses, lines, path[known], path[blind], problems[blind])


def _divide_path(frames: FrameRows, origin: LocalMetres, bin_m: float) -> tuple[Floats, float]:
    """Return the bin centres (B, 3) of the path on the ground, and the length of a bin.

    The length is about `bin_m`, more for paths that an outlier position makes very long.
    """
    flown = distance_flown_m(frames)
    known = np.isfinite(flown) & np.isfinite(frames.lat_deg) & np.isfinite(frames.lon_deg)
    if known.sum() < 2 or flown[known][-1] < bin_m:
        return np.zeros((0, 3)), bin_m
    positions = origin.to_metres(frames.lat_deg[known], frames.lon_deg[known])
    total = flown[known][-1]
    n_bins = min(max(1, round(total / bin_m)), _MAX_BINS)
    at = (np.arange(n_bins) + 0.5) * total / n_bins
    columns = [np.interp(at, flown[known], column) for column in positions.T]
    return np.column_stack((*columns, np.zeros(n_bins))), total / n_bins


def _within_reach(centres: Floats, cameras: CameraPoses, rules: Rules) -> Ints:
    """Return the bins (B, 3) near enough to any camera to be shown finely."""
    reach_m = rules.coverage["max_gsd_m"] * cameras.focal_px
    known = np.isfinite(cameras.positions[:, :2]).all(axis=1) & np.isfinite(reach_m)
    if not known.any():
        return np.zeros(0, np.int64)
    positions, farthest_m = cameras.positions[known, :2], reach_m[known].max()
    low, high = positions.min(axis=0) - farthest_m, positions.max(axis=0) + farthest_m
    within = np.flatnonzero(((centres[:, :2] >= low) & (centres[:, :2] <= high)).all(axis=1))
    # One by one, as an outlier position would include all bins on its way.
    near = np.zeros(len(within), bool)
    for position in positions:
        near |= (np.abs(centres[within, :2] - position) <= farthest_m).all(axis=1)
    return within[near]


def _fine_only(gsd_m: Floats, rules: Rules) -> Floats:
    """Return metres per pixel where they are at most max_gsd_m, else NaN."""
    with np.errstate(invalid="ignore"):
        return np.where(gsd_m <= rules.coverage["max_gsd_m"], gsd_m, np.nan)


class _BinCounts:
    """Count the frames that show each of some bins, over the cameras of a flight."""

    def __init__(self, n_bins: int) -> None:
        self.n_frames = np.zeros(n_bins, np.int64)
        self.n_detected = np.zeros(n_bins, np.int64)
        self.best_gsd_m = np.full(n_bins, np.nan)
        self.first_ns = np.full(n_bins, np.iinfo(np.int64).max)
        self.last_ns = np.zeros(n_bins, np.int64)
        self.blind = np.zeros(n_bins, bool)
        self.reason: str | None = None

    def add(self, bins: Ints, gsd_m: Floats, hit: Mask, times_ns: Ints) -> None:
        """Count frames with times (N,) for distinct bins (B,).

        gsd_m (N, B) is NaN where a frame does not show a bin. hit (N, B) is ignored there.
        """
        hit = hit & np.isfinite(gsd_m)
        self.n_frames[bins] += np.isfinite(gsd_m).sum(axis=0)
        self.n_detected[bins] += hit.sum(axis=0)
        finest = np.fmin.reduce(gsd_m, axis=0, initial=np.nan)
        self.best_gsd_m[bins] = np.fmin(self.best_gsd_m[bins], finest)
        rows, columns = np.nonzero(hit)
        np.minimum.at(self.first_ns, bins[columns], times_ns[rows])
        np.maximum.at(self.last_ns, bins[columns], times_ns[rows])

    def add_unknown(self, blind: Mask, problems: Ints) -> None:
        """Mark bins (B,) near frames whose pose has a problem."""
        if blind.any():
            self.blind |= blind
            self.reason = self.reason or commonest_problem(problems)

    def to_bins(
        self, kind: Literal["span", "corridor"], centres: Floats, bin_m: float, origin: LocalMetres
    ) -> Bins:
        """Return the rows of bins with centres (B, 3)."""
        lat_deg, lon_deg = origin.to_degrees(centres[:, :2])
        # A blind camera may show bins beyond those near its path.
        reached = np.full(len(centres), self.blind.any()) if not self.n_frames.any() else self.blind
        is_unknown = reached & (self.n_frames == 0)
        return Bins(
            kind,
            bin_m,
            lat_deg,
            lon_deg,
            self.n_frames,
            self.n_detected,
            self.best_gsd_m,
            self.first_ns,
            self.last_ns,
            is_unknown,
            self.reason if is_unknown.any() else None,
        )
