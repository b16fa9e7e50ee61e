"""What the frames of a camera show of a span, in metres along and across it.

Lines are taken to lie at the height of the span's conductors: in this plane, a line of the picture becomes
points (along, across). A conductor that hangs lower appears farther away, one that hangs higher nearer.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from inspect_pipeline.arrays import Floats, Ints, Mask
    from inspect_pipeline.geometry.camera import CameraPoses
    from inspect_pipeline.geometry.local_frame import LocalMetres
    from inspect_pipeline.inspection.rows import LineRows
    from inspect_pipeline.inspection.rules import Rules
    from inspect_pipeline.inspection.spans import Span


_CELLS_AT_A_TIME = 1 << 18  # frames times places, so that memory does not grow with the flight
_POINTS_AT_A_TIME = 64  # neighbours, which few frames show
_SLACK_M = 1e-3  # far more than what rounding moves


@dataclass(frozen=True, eq=False)
class SpanAxis:
    """A span in local metres, cut into bins: `middles` (B, 3) of them, on the axis of its conductors.

    along, across: (2,) unit vectors of the plane.
    """

    span_id: str
    start: Floats
    along: Floats
    across: Floats
    length_m: float
    bin_m: float
    height_m: float
    middles: Floats
    expected_conductors: int | None

    @property
    def bins_m(self) -> Floats:
        """(B,) the middles of the bins, along."""
        middles: Floats = np.arange(0.5, len(self.middles)) * self.bin_m
        return middles


@dataclass(frozen=True, eq=False)
class SpanView:
    """What frames show of a span.

    gsd_m (N, B): metres per pixel where a frame shows the middle of a bin, else NaN.
    For each crossing of a line with the middle of a bin, in arrays (C,): the row of its frame, its line, the
    bin, and how far across in metres.
    """

    gsd_m: Floats
    frame: Ints
    line: Ints
    bin: Ints
    across_m: Floats

    def select(self, chosen: Mask) -> SpanView:
        """The view with some of the crossings."""
        frame, line, bins = (column[chosen] for column in (self.frame, self.line, self.bin))
        return SpanView(self.gsd_m, frame, line, bins, self.across_m[chosen])


@dataclass(frozen=True, eq=False)
class Sight:
    """The frames `rows` of a camera, from the first to the last that show a span, and their lines.

    Lines count frames from the first of the rows.
    """

    rows: slice
    cameras: CameraPoses
    lines: LineRows


def make_axis(span: Span, origin: LocalMetres, rules: Rules) -> SpanAxis:
    """The axis of a span; conductors whose height is not known hang at the default, sagging as usual."""
    limits = rules.coverage
    start = origin.to_metres(span.from_lat_deg, span.from_lon_deg)
    end = origin.to_metres(span.to_lat_deg, span.to_lon_deg)
    length_m = float(np.hypot(*(end - start)))
    along = (end - start) / max(length_m, 1e-9)
    n_bins = max(1, round(length_m / limits["bin_m"]))
    shares = (np.arange(n_bins) + 0.5) / n_bins
    heights = [limits["default_height_m"] if h is None else h for h in (span.from_height_m, span.to_height_m)]
    drops = 4 * limits["sag_share"] * length_m * shares * (1 - shares)
    middles = start + shares[:, np.newaxis] * (end - start)
    z = heights[0] + shares * (heights[1] - heights[0]) - drops
    return SpanAxis(
        span_id=span.span_id,
        start=start,
        along=along,
        across=np.array([-along[1], along[0]]),
        length_m=length_m,
        bin_m=length_m / n_bins,
        height_m=sum(heights) / 2,
        middles=np.column_stack((middles, z)),
        expected_conductors=span.expected_conductors,
    )


def visible_gsd_m(cameras: CameraPoses, points: Floats, margin_px: float = 0.0) -> Floats:
    """(N, P): metres per pixel where a camera sees a point, else NaN."""
    gsd_m = np.full((len(cameras.positions), len(points)), np.nan)
    for start in range(0, len(points), _POINTS_AT_A_TIME):
        some = points[start : start + _POINTS_AT_A_TIME]
        rows = _may_see(cameras, some)
        if len(rows):
            gsd_m[rows, start : start + len(some)] = _gsd_m(cameras[rows], some, margin_px)
    return gsd_m


def _may_see(cameras: CameraPoses, points: Floats) -> Ints:
    """The rows of cameras whose pyramid of sight meets a ball around (P, 3) points."""
    middle, radius_m = _ball(points)
    with np.errstate(invalid="ignore", divide="ignore"):
        slopes = np.abs(cameras.sizes) / (2 * np.abs(cameras.focal_px[:, np.newaxis]))
        seen = np.einsum("nij,nj->ni", cameras.axes, middle - cameras.positions)
        beyond = np.abs(seen[:, :2]) - slopes * seen[:, 2:] > radius_m * np.hypot(1, slopes)
    is_known = np.isfinite(seen).all(axis=1) & np.isfinite(cameras.focal_px)
    return np.flatnonzero(is_known & ~beyond.any(axis=1) & (seen[:, 2] > -radius_m))


def _gsd_m(cameras: CameraPoses, points: Floats, margin_px: float) -> Floats:
    """What `visible_gsd_m` says, computed for each camera and point."""
    with np.errstate(invalid="ignore"):
        pixels, depths = cameras.project(points)
        limits = cameras.sizes[:, np.newaxis] - margin_px
        is_seen = (depths > 0) & ((pixels >= margin_px) & (pixels < limits)).all(axis=-1)
        ranges_m = np.linalg.norm(points[np.newaxis] - cameras.positions[:, np.newaxis], axis=-1)
        gsd_m: Floats = np.where(is_seen, ranges_m / cameras.focal_px[:, np.newaxis], np.nan)
    return gsd_m


def cut_to_sight(points: Floats, cameras: CameraPoses, lines: LineRows) -> Sight:
    """What of a flight is about (P, 3) points: frames that see any of them, and those of their lines."""
    step = max(1, _CELLS_AT_A_TIME // max(len(points), 1))
    seen = [
        start + np.flatnonzero(np.isfinite(visible_gsd_m(cameras[start : start + step], points)).any(axis=1))
        for start in range(0, len(cameras.positions), step)
    ]
    rows = np.concatenate(seen) if seen else np.zeros(0, np.int64)
    if not len(rows):
        return Sight(slice(0, 0), cameras[:0], lines.of_frames(0, 0))
    stop = int(rows[-1]) + 1
    own = lines.of_frames(int(rows[0]), stop)
    start = int(own.picture.min(initial=rows[0]))  # lines may be those of a picture before
    return Sight(slice(start, stop), cameras[start:stop], own.counted_from(start))


def view_span(
    axis: SpanAxis, cameras: CameraPoses, lines: LineRows, rules: Rules, margin_px: float = 0.0
) -> SpanView:
    """What the frames show of a span, and which lines run along it."""
    limits = rules.coverage
    gsd_m = visible_gsd_m(cameras, axis.middles, margin_px)
    places = to_plane(axis, cameras, lines)
    frame, line, bins, across_m = _crossings(axis, lines, places, limits["max_angle_deg"])
    is_near = (np.abs(across_m) <= limits["corridor_half_m"]) & np.isfinite(gsd_m[frame, bins])
    return SpanView(gsd_m, frame[is_near], line[is_near], bins[is_near], across_m[is_near])


def to_plane(axis: SpanAxis, cameras: CameraPoses, lines: LineRows) -> Floats:
    """(P, 2) metres along and across of the points of lines; NaN for what is not below the camera."""
    owner = np.repeat(lines.picture, np.diff(lines.first))
    with np.errstate(invalid="ignore", divide="ignore"):
        rays = cameras.rays(owner, lines.points)
        reach = (axis.height_m - cameras.positions[owner, 2]) / rays[:, 2]
        ground = cameras.positions[owner, :2] + reach[:, np.newaxis] * rays[:, :2] - axis.start
        ground[~(reach > 0)] = np.nan
    return np.column_stack((ground @ axis.along, ground @ axis.across))


def _crossings(
    axis: SpanAxis, lines: LineRows, places: Floats, max_angle_deg: float
) -> tuple[Ints, Ints, Ints, Floats]:
    """Where lines that run along the axis cross the middles of its bins: frame, line, bin, across."""
    line = np.repeat(np.arange(len(lines)), np.diff(lines.first))
    is_piece = line[1:] == line[:-1]
    begin, end, owner = places[:-1][is_piece], places[1:][is_piece], line[:-1][is_piece]
    chord = places[lines.first[1:] - 1] - places[lines.first[:-1]]
    with np.errstate(invalid="ignore"):
        is_along = np.abs(chord[:, 1]) <= np.tan(np.radians(max_angle_deg)) * np.abs(chord[:, 0])
        low = np.minimum(begin[:, 0], end[:, 0]) / axis.bin_m - 0.5
        high = np.maximum(begin[:, 0], end[:, 0]) / axis.bin_m - 0.5
        kept = is_along[owner] & np.isfinite(low + high) & (high >= 0) & (low < len(axis.middles))
    begin, end, owner = begin[kept], end[kept], owner[kept]
    first = np.maximum(np.ceil(low[kept]), 0).astype(np.int64)
    stop = np.minimum(np.ceil(high[kept]), len(axis.middles)).astype(np.int64)
    counts = np.maximum(stop - first, 0)
    piece = np.repeat(np.arange(len(counts)), counts)
    bins = first[piece] + np.arange(len(piece)) - np.repeat(np.cumsum(counts) - counts, counts)
    run = end[piece] - begin[piece]
    share = (axis.bins_m[bins] - begin[piece, 0]) / np.where(run[:, 0] == 0, 1.0, run[:, 0])
    across_m = begin[piece, 1] + share * run[:, 1]
    # A line that wavers over the middle of a bin crosses it once.
    key = owner[piece] * len(axis.middles) + bins
    _, once = np.unique(key, return_index=True)
    owner = owner[piece][once]
    return lines.frame[owner], owner, bins[once], across_m[once]


def is_near(places: Floats, path: Floats, near_m: float) -> bool:
    """Whether any of (B, 2) places is within a distance of any of (N, 2) places of a path."""
    path = path[:: max(1, len(path) // 2000)]
    for start in range(0, len(places), _POINTS_AT_A_TIME):
        some = places[start : start + _POINTS_AT_A_TIME]
        middle, radius_m = _ball(some)
        within = path[np.hypot(*(path - middle).T) <= near_m + radius_m]
        away = some[:, np.newaxis] - within[np.newaxis]
        if (np.hypot(away[..., 0], away[..., 1]) <= near_m).any():
            return True
    return False


def _ball(points: Floats) -> tuple[Floats, float]:
    """Middle and radius of a ball that has all of some points in it."""
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    return middle, float(np.linalg.norm(points - middle, axis=1).max()) + _SLACK_M
