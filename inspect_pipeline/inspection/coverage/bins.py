"""Pieces of spans, and of the ground below the path, and how often and how finely frames show each."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from inspect_pipeline.inspection.coverage.frames import has_lines
from inspect_pipeline.inspection.coverage.rows import Bins
from inspect_pipeline.inspection.rows import judge_frames, path_metres, place_cameras, tracked_lines
from inspect_pipeline.inspection.span_view import cut_to_sight, is_near, make_axis, view_span, visible_gsd_m

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from inspect_pipeline.arrays import Floats, Ints, Mask
    from inspect_pipeline.geometry.camera import CameraPoses
    from inspect_pipeline.geometry.local_frame import LocalMetres
    from inspect_pipeline.inspection.rows import CameraRows, FrameRows
    from inspect_pipeline.inspection.rules import Rules
    from inspect_pipeline.inspection.spans import Span


_FRAMES_AT_A_TIME = 64
_MAX_BINS = 100_000  # of a path: 100 km by the shipped rules


def span_bins(
    cameras: Sequence[CameraRows], spans: Sequence[Span], origin: LocalMetres, rules: Rules
) -> Iterator[Bins]:
    """The bins of the spans near the path."""
    known = [(c.frames, _usable_cameras(c, origin, rules), tracked_lines(c.lines, rules)) for c in cameras]
    paths = [origin.to_metres(frames.lat_deg, frames.lon_deg) for frames, _, _ in known]
    path = np.concatenate(paths)
    path = path[np.isfinite(path).all(axis=1)]
    for span in spans:
        axis = make_axis(span, origin, rules)
        if not is_near(axis.middles[:, :2], path, rules.coverage["near_m"]):
            continue
        seen = _Seen(len(axis.middles))
        for frames, placed, lines in known:
            sight = cut_to_sight(axis.middles, placed, lines)
            view = view_span(axis, sight.cameras, sight.lines, rules)
            shown = _fine(view.gsd_m, rules)
            hit = np.zeros(shown.shape, bool)
            hit[view.frame, view.bin] = True
            seen.add(np.arange(len(axis.middles)), shown, hit, frames.log_time_ns[sight.rows])
        yield seen.to_bins("span", span.span_id, axis.bin_m, axis.middles, origin)


def corridor_bins(cameras: Sequence[CameraRows], origin: LocalMetres, rules: Rules) -> Iterator[Bins]:
    """The bins of the path on the ground, of the first camera with positions: all fly together."""
    flown = next(c.frames for c in cameras if np.isfinite(c.frames.lat_deg).any())
    middles, bin_m = _cut_path(flown, origin, rules.coverage["bin_m"])
    if not len(middles):
        return
    seen = _Seen(len(middles))
    for camera in cameras:
        placed, found = _usable_cameras(camera, origin, rules), has_lines(camera, rules)
        for start in range(0, len(found), _FRAMES_AT_A_TIME):
            rows = slice(start, start + _FRAMES_AT_A_TIME)
            bins = _within_reach(middles, placed[rows], rules)
            shown = _fine(visible_gsd_m(placed[rows], middles[bins]), rules)
            hit = np.isfinite(shown) & found[rows, np.newaxis]
            seen.add(bins, shown, hit, camera.frames.log_time_ns[rows])
    yield seen.to_bins("corridor", None, bin_m, middles, origin)


def _usable_cameras(camera: CameraRows, origin: LocalMetres, rules: Rules) -> CameraPoses:
    """The cameras of the frames; those of frames that cannot be used are nowhere."""
    placed = place_cameras(camera.frames, origin, rules)
    placed.positions[~judge_frames(camera.frames, rules).usable] = np.nan
    return placed


def _cut_path(frames: FrameRows, origin: LocalMetres, bin_m: float) -> tuple[Floats, float]:
    """(B, 3) the middles of pieces of the path, on the ground, and how long each is.

    About `bin_m`, but for paths that a jump of positions makes very long.
    """
    walked = path_metres(frames)
    known = np.isfinite(walked) & np.isfinite(frames.lat_deg) & np.isfinite(frames.lon_deg)
    if known.sum() < 2 or walked[known][-1] < bin_m:
        return np.zeros((0, 3)), bin_m
    places = origin.to_metres(frames.lat_deg[known], frames.lon_deg[known])
    total = walked[known][-1]
    n_bins = min(max(1, round(total / bin_m)), _MAX_BINS)
    at = (np.arange(n_bins) + 0.5) * total / n_bins
    columns = [np.interp(at, walked[known], column) for column in places.T]
    return np.column_stack((*columns, np.zeros(n_bins))), total / n_bins


def _within_reach(middles: Floats, cameras: CameraPoses, rules: Rules) -> Ints:
    """Which of (B, 3) places may be near enough to any of the cameras to be seen finely."""
    reach_m = rules.coverage["max_gsd_m"] * cameras.focal_px
    known = np.isfinite(cameras.positions[:, :2]).all(axis=1) & np.isfinite(reach_m)
    if not known.any():
        return np.zeros(0, np.int64)
    positions, farthest_m = cameras.positions[known, :2], reach_m[known].max()
    low, high = positions.min(axis=0) - farthest_m, positions.max(axis=0) + farthest_m
    within = np.flatnonzero(((middles[:, :2] >= low) & (middles[:, :2] <= high)).all(axis=1))
    # One by one, as a position that jumps would take in all on its way.
    is_near = np.zeros(len(within), bool)
    for position in positions:
        is_near |= (np.abs(middles[within, :2] - position) <= farthest_m).all(axis=1)
    return within[is_near]


def _fine(gsd_m: Floats, rules: Rules) -> Floats:
    """The metres per pixel where a frame shows a bin finely enough, else NaN."""
    with np.errstate(invalid="ignore"):
        return np.where(gsd_m <= rules.coverage["max_gsd_m"], gsd_m, np.nan)


class _Seen:
    """What the cameras of a flight saw of bins."""

    def __init__(self, n_bins: int) -> None:
        self.n_frames = np.zeros(n_bins, np.int64)
        self.n_detected = np.zeros(n_bins, np.int64)
        self.best_gsd_m = np.full(n_bins, np.nan)
        self.first_ns = np.full(n_bins, np.iinfo(np.int64).max)
        self.last_ns = np.zeros(n_bins, np.int64)

    def add(self, bins: Ints, gsd_m: Floats, hit: Mask, times_ns: Ints) -> None:
        """Count frames taken at (N,) times, for some bins (B,), each once.

        gsd_m (N, B) is NaN where a frame does not show a bin; what hit (N, B) has besides does not count.
        """
        hit = hit & np.isfinite(gsd_m)
        self.n_frames[bins] += np.isfinite(gsd_m).sum(axis=0)
        self.n_detected[bins] += hit.sum(axis=0)
        finest = np.fmin.reduce(gsd_m, axis=0, initial=np.nan)
        self.best_gsd_m[bins] = np.fmin(self.best_gsd_m[bins], finest)
        rows, columns = np.nonzero(hit)
        np.minimum.at(self.first_ns, bins[columns], times_ns[rows])
        np.maximum.at(self.last_ns, bins[columns], times_ns[rows])

    def to_bins(
        self,
        kind: Literal["span", "corridor"],
        span_id: str | None,
        bin_m: float,
        middles: Floats,
        origin: LocalMetres,
    ) -> Bins:
        """The rows, of bins with (B, 3) middles."""
        lat_deg, lon_deg = origin.to_degrees(middles[:, :2])
        return Bins(
            kind,
            span_id,
            bin_m,
            lat_deg,
            lon_deg,
            self.n_frames,
            self.n_detected,
            self.best_gsd_m,
            self.first_ns,
            self.last_ns,
        )
