"""Views of a span: image lines projected to the nominal height of its conductors, in metres along and across.

That is the chord between the structures less an assumed sag. A line that hangs lower appears farther from the
camera there, one that hangs higher nearer.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from inspect_pipeline.inspection.rows import count_up
from inspect_pipeline.inspection.terrain import LEVEL

if TYPE_CHECKING:
    from inspect_pipeline.arrays import Floats, Ints, Mask
    from inspect_pipeline.geometry.camera import CameraPoses
    from inspect_pipeline.geometry.local_frame import LocalMetres
    from inspect_pipeline.inspection.rows import LineRows
    from inspect_pipeline.inspection.rules import Rules
    from inspect_pipeline.inspection.spans import Span
    from inspect_pipeline.inspection.terrain import Ground


_CELLS_AT_A_TIME = 1 << 18  # frames times points, to bound memory
_POINTS_AT_A_TIME = 64  # neighbours, visible in few frames
_SAG_ITERATIONS = 3  # of where a line of sight meets a conductor that sags
_SLACK_M = 1e-3  # well above rounding errors


@dataclass(frozen=True, eq=False)
class SpanAxis:
    """Axis of a span in local metres, divided into bins with centres `centres` (B, 3).

    along, across: horizontal unit vectors (2,). chord_m (B,): height of the chord between the structures.
    ground_m (B,): height of the ground below. is_ground_known: whether it is near both structures. Heights
    are above the ground at the first position.
    """

    span_id: str
    start: Floats
    along: Floats
    across: Floats
    length_m: float
    bin_m: float
    height_m: float
    centres: Floats
    chord_m: Floats
    ground_m: Floats
    is_ground_known: bool
    expected_conductors: int | None

    @property
    def bins_m(self) -> Floats:
        """Positions of the bin centres along the axis (B,)."""
        positions: Floats = np.arange(0.5, len(self.centres)) * self.bin_m
        return positions

    def n_bins(self, length_m: float) -> int:
        """Return how many bins are as long as a length, to the nearest one."""
        return round(length_m / self.bin_m)


@dataclass(frozen=True, eq=False)
class SpanView:
    """Visible bins of a span, and the lines along it.

    gsd_m (N, B): metres per pixel where a frame shows the centre of a bin, else NaN. Where line `line` of
    frame `frame` crosses the centre of bin `bin`, it is `across_m` to the left of the axis: arrays (C,).
    """

    gsd_m: Floats
    frame: Ints
    line: Ints
    bin: Ints
    across_m: Floats

    def select(self, chosen: Mask) -> SpanView:
        """Return the view with some of the crossings."""
        frame, line, bins = (column[chosen] for column in (self.frame, self.line, self.bin))
        return SpanView(self.gsd_m, frame, line, bins, self.across_m[chosen])


@dataclass(frozen=True, eq=False)
class FrameRange:
    """Consecutive frames `rows` of a camera with their poses and lines. Line rows count from its first."""

    rows: slice
    cameras: CameraPoses
    lines: LineRows


def make_axis(span: Span, origin: LocalMetres, rules: Rules, ground: Ground = LEVEL) -> SpanAxis:
    """Return the axis of a span, on its ground, with the default height and sag where they are not given."""
    limits = rules.coverage
    start = origin.to_metres(span.from_lat_deg, span.from_lon_deg)
    end = origin.to_metres(span.to_lat_deg, span.to_lon_deg)
    length_m = float(np.hypot(*(end - start)))
    along = (end - start) / max(length_m, 1e-9)
    n_bins = max(1, round(length_m / limits["bin_m"]))
    shares = (np.arange(n_bins) + 0.5) / n_bins
    heights = [limits["default_height_m"] if h is None else h for h in (span.from_height_m, span.to_height_m)]
    heights = (np.array(heights) + ground.at(np.stack((start, end)))).tolist()
    drops = 4 * limits["sag_share"] * length_m * shares * (1 - shares)
    centres = start + shares[:, np.newaxis] * (end - start)
    chord_m = heights[0] + shares * (heights[1] - heights[0])
    return SpanAxis(
        span_id=span.span_id,
        start=start,
        along=along,
        across=np.array([-along[1], along[0]]),
        length_m=length_m,
        bin_m=length_m / n_bins,
        height_m=sum(heights) / 2,
        centres=np.column_stack((centres, chord_m - drops)),
        chord_m=chord_m,
        ground_m=ground.at(centres),
        is_ground_known=ground.is_known(np.stack((start, end))),
        expected_conductors=span.expected_conductors,
    )


def visible_gsd_m(cameras: CameraPoses, points: Floats, margin_px: float = 0.0) -> Floats:
    """Return metres per pixel (N, P) where a camera sees a point (P, 3), else NaN."""
    gsd_m = np.full((len(cameras.positions), len(points)), np.nan)
    for start in range(0, len(points), _POINTS_AT_A_TIME):
        some = points[start : start + _POINTS_AT_A_TIME]
        rows = _may_see(cameras, some)
        if len(rows):
            gsd_m[rows, start : start + len(some)] = _gsd_m(cameras[rows], some, margin_px)
    return gsd_m


def _may_see(cameras: CameraPoses, points: Floats) -> Ints:
    """Return the rows of cameras whose view frustum meets the bounding sphere of points (P, 3)."""
    centre, radius_m = _bounding_sphere(points)
    with np.errstate(invalid="ignore", divide="ignore"):
        slopes = np.abs(cameras.sizes) / (2 * np.abs(cameras.focal_px[:, np.newaxis]))
        local = np.einsum("nij,nj->ni", cameras.axes, centre - cameras.positions)
        beyond = np.abs(local[:, :2]) - slopes * local[:, 2:] > radius_m * np.hypot(1, slopes)
    is_known = np.isfinite(local).all(axis=1) & np.isfinite(cameras.focal_px)
    return np.flatnonzero(is_known & ~beyond.any(axis=1) & (local[:, 2] > -radius_m))


def _gsd_m(cameras: CameraPoses, points: Floats, margin_px: float) -> Floats:
    """Compute `visible_gsd_m` for all pairs of cameras and points."""
    with np.errstate(invalid="ignore"):
        pixels, depths = cameras.project(points)
        limits = cameras.sizes[:, np.newaxis] - margin_px
        is_visible = (depths > 0) & ((pixels >= margin_px) & (pixels < limits)).all(axis=-1)
        ranges_m = np.linalg.norm(points[np.newaxis] - cameras.positions[:, np.newaxis], axis=-1)
        gsd_m: Floats = np.where(is_visible, ranges_m / cameras.focal_px[:, np.newaxis], np.nan)
    return gsd_m


def select_frames(points: Floats, cameras: CameraPoses, lines: LineRows) -> FrameRange:
    """Return the frames from the first to the last that see any of the points (P, 3)."""
    step = max(1, _CELLS_AT_A_TIME // max(len(points), 1))
    visible = [
        start + np.flatnonzero(np.isfinite(visible_gsd_m(cameras[start : start + step], points)).any(axis=1))
        for start in range(0, len(cameras.positions), step)
    ]
    rows = np.concatenate(visible) if visible else np.zeros(0, np.int64)
    if not len(rows):
        return FrameRange(slice(0, 0), cameras[:0], lines.in_frames(0, 0))
    stop = int(rows[-1]) + 1
    own = lines.in_frames(int(rows[0]), stop)
    start = int(own.detected_in.min(initial=rows[0]))  # lines may be carried over from earlier frames
    return FrameRange(slice(start, stop), cameras[start:stop], own.shift_frames(-start))


def view_span(
    axis: SpanAxis, cameras: CameraPoses, lines: LineRows, rules: Rules, margin_px: float = 0.0
) -> SpanView:
    """Return the visible bins of a span and the lines that run along it."""
    limits = rules.coverage
    gsd_m = visible_gsd_m(cameras, axis.centres, margin_px)
    places = project_to_plane(axis, cameras, lines)
    frame, line, bins, across_m = _crossings(axis, lines, places, limits["max_angle_deg"])
    is_near = (np.abs(across_m) <= limits["corridor_half_m"]) & np.isfinite(gsd_m[frame, bins])
    return SpanView(gsd_m, frame[is_near], line[is_near], bins[is_near], across_m[is_near])


def project_to_plane(axis: SpanAxis, cameras: CameraPoses, lines: LineRows) -> Floats:
    """Project line points to the nominal height of the conductors: metres along and across (P, 2).

    NaN above the camera.
    """
    owner = np.repeat(lines.detected_in, np.diff(lines.first))
    height_m: Floats | float = axis.height_m
    with np.errstate(invalid="ignore", divide="ignore"):
        rays = cameras.rays(owner, lines.points)
        for _ in range(_SAG_ITERATIONS):
            reach = (height_m - cameras.positions[owner, 2]) / rays[:, 2]
            ground = cameras.positions[owner, :2] + reach[:, np.newaxis] * rays[:, :2] - axis.start
            along_m = ground @ axis.along
            height_m = np.interp(along_m, axis.bins_m, axis.centres[:, 2])
        ground[~(reach > 0)] = np.nan
    return np.column_stack((ground @ axis.along, ground @ axis.across))


def _crossings(
    axis: SpanAxis, lines: LineRows, places: Floats, max_angle_deg: float
) -> tuple[Ints, Ints, Ints, Floats]:
    """Return where lines along the axis cross bin centres: frame, line, bin, across (C,)."""
    line = np.repeat(np.arange(len(lines)), np.diff(lines.first))
    is_piece = line[1:] == line[:-1]
    begin, end, owner = places[:-1][is_piece], places[1:][is_piece], line[:-1][is_piece]
    chord = places[lines.first[1:] - 1] - places[lines.first[:-1]]
    with np.errstate(invalid="ignore"):
        is_along = np.abs(chord[:, 1]) <= np.tan(np.radians(max_angle_deg)) * np.abs(chord[:, 0])
        low = np.minimum(begin[:, 0], end[:, 0]) / axis.bin_m - 0.5
        high = np.maximum(begin[:, 0], end[:, 0]) / axis.bin_m - 0.5
        kept = is_along[owner] & np.isfinite(low + high) & (high >= 0) & (low < len(axis.centres))
    begin, end, owner = begin[kept], end[kept], owner[kept]
    first = np.maximum(np.ceil(low[kept]), 0).astype(np.int64)
    stop = np.minimum(np.ceil(high[kept]), len(axis.centres)).astype(np.int64)
    counts = np.maximum(stop - first, 0)
    piece = np.repeat(np.arange(len(counts)), counts)
    bins = first[piece] + count_up(counts)
    run = end[piece] - begin[piece]
    share = (axis.bins_m[bins] - begin[piece, 0]) / np.where(run[:, 0] == 0, 1.0, run[:, 0])
    across_m = begin[piece, 1] + share * run[:, 1]
    # Count a line that crosses a bin centre repeatedly once.
    key = owner[piece] * len(axis.centres) + bins
    _, once = np.unique(key, return_index=True)
    owner = owner[piece][once]
    return lines.frame[owner], owner, bins[once], across_m[once]


def near_path(points: Floats, path: Floats, near_m: float) -> Mask:
    """Return which points (B, 2) are within a distance of any position of a path (N, 2)."""
    near = np.zeros(len(points), bool)
    path = path[:: max(1, len(path) // 2000)]
    for start in range(0, len(points), _POINTS_AT_A_TIME):
        some = points[start : start + _POINTS_AT_A_TIME]
        centre, radius_m = _bounding_sphere(some)
        within = path[np.hypot(*(path - centre).T) <= near_m + radius_m]
        away = some[:, np.newaxis] - within[np.newaxis]
        near[start : start + len(some)] = (np.hypot(away[..., 0], away[..., 1]) <= near_m).any(axis=1)
    return near


def _bounding_sphere(points: Floats) -> tuple[Floats, float]:
    """Return centre and radius of a sphere around all points."""
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    return centre, float(np.linalg.norm(points - centre, axis=1).max()) + _SLACK_M
