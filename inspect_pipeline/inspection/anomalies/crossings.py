"""Rule about lines that cross a span: those that frames show in one place in space.

Lines are projected to planes at several heights. On that of a line across the span, those of all frames
coincide, whatever their tracks; false lines do not. Conductors of other spans cross nothing: those of known
spans are told by their tracks, those of others by where they begin, at a structure of this span.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from inspect_pipeline.inspection.anomalies.frames import Finding
from inspect_pipeline.inspection.conductors.matching import NO_CONDUCTOR
from inspect_pipeline.inspection.rows import find_runs
from inspect_pipeline.inspection.span_view import visible_gsd_m

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from inspect_pipeline.arrays import Floats, Ints, Mask
    from inspect_pipeline.geometry.local_frame import LocalMetres
    from inspect_pipeline.inspection.conductors.sight import SpanSight
    from inspect_pipeline.inspection.rules import Rules
    from inspect_pipeline.inspection.span_evidence import SpanEvidence

_HEIGHT_STEP_M = 1.5
_MAX_TURN_DEG, _MAX_AWAY_M = 6.0, 0.7  # of two that coincide
_AWAY_SD = 1.5  # times the errors of positions: so much farther away they may be
_MIN_LENGTH_M, _MAX_RANGE_M = 1.0, 80.0
_MAX_PIECES = 600
_MOSTLY = 0.5  # of the lines of a track
_NEAR_FRAMES = 2
_MOST_ROWS = 1 << 32
_MAX_MISSED_M, _MAX_BEYOND_M = 1.0, 1.5  # an attachment: beside it, and beyond it, of what begins there
_NEARER_M = np.array([-0.75, -0.5, -0.25, 0.25, 0.5, 0.75])
_ENDS, _N_POINTS = 0.05, 41  # of a line: frames that disagree about its ends; points along it
_MIN_VISIBLE_SHARE = 0.35  # of the frames that show some of it
_SHOWN_SHARE = 0.1  # of the most that a frame shows of it
_SHOWN_M = np.array([-2.0, 0.0, 2.0])  # from the middle of a line: points that a frame should show


@dataclass(frozen=True, eq=False)
class _Pieces:
    """Lines across a span on a plane at a height.

    frame (M,), middle (M, 2) in metres along and across, direction (M, 2), half_m (M,) of length, track (M,).
    """

    height_m: float
    frame: Ints
    middle: Floats
    direction: Floats
    half_m: Floats
    track: Ints

    @property
    def angle_deg(self) -> Floats:
        """Angles (M,) to the axis of the span, 0 to 90."""
        return np.asarray(np.degrees(np.arctan2(*np.abs(self.direction[:, ::-1]).T)))

    def take(self, chosen: Ints | Mask) -> _Pieces:
        return _Pieces(
            self.height_m,
            self.frame[chosen],
            self.middle[chosen],
            self.direction[chosen],
            self.half_m[chosen],
            self.track[chosen],
        )


def find_crossings_of_span(
    one: SpanEvidence, others: Sequence[SpanEvidence], origin: LocalMetres, rules: Rules
) -> Iterator[Finding]:
    """Find the line across a span that most frames show, if those show it that should.

    others: further spans, whose conductors are no such lines.
    """
    limits = rules.of("crossing_line")
    found = _find_alike(one, _without_spans(one, others), rules)
    if found is None:
        return
    hits = np.unique(found.frame)
    visible, should = _frames_showing(one.sight, found, rules)
    is_rare = should[hits].sum() < limits["min_share"] * should.sum()
    if len(hits) < limits["min_frames"] or is_rare or len(hits) < _MIN_VISIBLE_SHARE * visible.sum():
        return
    visible[hits] = True
    visits = [run for run in find_runs(visible, 1) if np.isin(run, hits).any()]
    rows = max(visits, key=len)
    angle_deg = float(np.median(found.angle_deg))
    place = one.axis.start + np.median(_on_axis(found)) * one.axis.along
    lat_deg, lon_deg = origin.to_degrees(place)
    yield Finding(
        "crossing_line",
        np.arange(one.sight.rows[rows[0]], one.sight.rows[rows[-1]] + 1),
        f"a line at {angle_deg:.0f} degrees across span {one.axis.span_id}, in {len(hits)} frames",
        angle_deg,
        limits["min_angle_deg"],
        "deg",
        track_id=_most_common(found.track),
        span_id=one.axis.span_id,
        place=(float(lat_deg), float(lon_deg)),
    )


def _find_alike(one: SpanEvidence, sight: SpanSight, rules: Rules) -> _Pieces | None:
    """Return the most lines across a span that coincide at some height, None without any.

    From opposite sides they coincide only near their own height: that is looked for more closely then.
    """
    best: _Pieces | None = None
    heights = np.arange(one.axis.ground_m.min(), one.axis.height_m + _HEIGHT_STEP_M / 2, _HEIGHT_STEP_M)
    for _ in range(2):
        planes = [_project(sight, height_m, rules) for height_m in heights.tolist()]
        best = _most_alike([best, *planes] if best else planes, one.sight.shift_sd_m)
        if best is None:
            break
        heights = best.height_m + _NEARER_M
    return best


def _without_spans(one: SpanEvidence, others: Sequence[SpanEvidence]) -> SpanSight:
    """Return the sight of a span without lines along others, and those that begin at its structures."""
    lines = one.sight.lines
    known = [_lines_along(other) for other in others if other is not one]
    is_other = np.isin(_keys(one, np.arange(len(lines))), np.concatenate([np.zeros(0, np.int64), *known]))
    is_other |= _begins_at_structure(one)
    return replace(one.sight, lines=lines.take(np.flatnonzero(~is_other)))


def _lines_along(one: SpanEvidence) -> Ints:
    """Return the keys of lines along a span, and of those of their tracks a few frames before and after.

    Their tracks are those of which most lines are of a conductor of the span. Other frames say nothing: a
    track may change from one conductor to another.
    """
    if one.votes is None:
        return np.zeros(0, np.int64)
    lines, is_owned = one.sight.lines, one.votes.owner != NO_CONDUCTOR
    tracks, inverse, counts = np.unique(lines.track, return_inverse=True, return_counts=True)
    is_along = np.bincount(inverse, is_owned, len(tracks)) > _MOSTLY * counts
    is_shown = np.bincount(one.sight.view.line, minlength=len(lines)) > 0
    keys = _keys(one, np.flatnonzero(is_along[inverse] & is_owned & is_shown))
    return np.unique(np.add.outer(np.arange(-_NEAR_FRAMES, _NEAR_FRAMES + 1), keys))


def _keys(one: SpanEvidence, lines: Ints) -> Ints:
    """Return numbers of lines by their track and frame; those of frames in a row are consecutive."""
    rows = one.sight.rows[one.sight.lines.frame[lines]]
    return np.asarray(one.sight.lines.track[lines] * _MOST_ROWS + rows)


def _begins_at_structure(one: SpanEvidence) -> Mask:
    """Return which lines (L,) begin where a conductor is attached, and lead away from the span.

    At a corner, arms are along the bisector.
    """
    sight, axis = one.sight, one.axis
    begins = np.zeros(len(sight.lines), bool)
    near_m = _MAX_MISSED_M + _AWAY_SD * sight.shift_sd_m
    for place in one.places:
        for outward, foot_m, height_m in ((-1, 0.0, axis.chord_m[0]), (1, axis.length_m, axis.chord_m[-1])):
            ends = _ends_on_plane(sight, height_m + place.raised_m) - (foot_m, 0.0)
            ends[:, 0] *= outward
            first, second = ends[::2], ends[1::2]
            is_swapped = (first[:, 0] > second[:, 0])[:, np.newaxis]
            first, second = np.where(is_swapped, second, first), np.where(is_swapped, first, second)
            with np.errstate(invalid="ignore", divide="ignore"):
                run = (second - first) / np.linalg.norm(second - first, axis=1)[:, np.newaxis]
                arm_m = place.across_m * np.tan(np.arctan2(run[:, 1], run[:, 0]) / 2)
                off = first - np.column_stack((-arm_m, np.full(len(run), place.across_m)))
                missed_m = np.abs(off[:, 0] * run[:, 1] - off[:, 1] * run[:, 0])
                beyond_m = -(off * run).sum(axis=1)
                begins |= (missed_m <= near_m) & (beyond_m <= _MAX_BEYOND_M)
    return begins


def _ends_on_plane(sight: SpanSight, height_m: float) -> Floats:
    """Return both ends of lines (2L, 2) on a plane, in metres along and across; NaN where far away."""
    lines, axis = sight.lines, sight.axis
    frame = np.repeat(lines.frame, 2)
    with np.errstate(invalid="ignore", divide="ignore"):
        rays = sight.cameras.rays(frame, lines.chords.reshape(-1, 2))
        reach = (height_m - sight.cameras.positions[frame, 2]) / rays[:, 2]
        away = reach[:, np.newaxis] * rays[:, :2]
        away[~((reach > 0) & (np.linalg.norm(away, axis=1) <= _MAX_RANGE_M))] = np.nan
    return np.column_stack(
        (sight.from_m[frame] + away @ axis.along, sight.side_m[frame] + away @ axis.across)
    )


def _project(sight: SpanSight, height_m: float, rules: Rules) -> _Pieces:
    """Return the lines across a span on a plane."""
    lines, axis, ends = sight.lines, sight.axis, _ends_on_plane(sight, height_m)
    begin, end = ends[::2], ends[1::2]
    runs = end - begin
    length_m = np.linalg.norm(runs, axis=1)
    with np.errstate(invalid="ignore"):
        directions = runs / length_m[:, np.newaxis]
        pieces = _Pieces(height_m, lines.frame, (begin + end) / 2, directions, length_m / 2, lines.track)
        nearest_m = np.where(begin[:, 1] * end[:, 1] < 0, 0.0, np.abs(ends[:, 1]).reshape(-1, 2).min(axis=1))
        on_axis = _on_axis(pieces)
        across = (
            (length_m >= _MIN_LENGTH_M)
            & (pieces.angle_deg >= rules.of("crossing_line")["min_angle_deg"])
            & (nearest_m <= rules.coverage["corridor_half_m"])
            & (on_axis >= 0)
            & (on_axis <= axis.length_m)
        )
    chosen = np.flatnonzero(across)
    return pieces.take(chosen[np.argsort(-length_m[chosen], kind="stable")[:_MAX_PIECES]])


def _on_axis(pieces: _Pieces) -> Floats:
    """Return where (M,) lines cross the axis, in metres along it."""
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = pieces.direction[:, 0] / pieces.direction[:, 1]
    return np.asarray(pieces.middle[:, 0] - slope * pieces.middle[:, 1])


def _most_alike(planes: Sequence[_Pieces], shift_sd_m: float) -> _Pieces | None:
    """Return the most lines that coincide on one of the planes, None without any."""
    most, best = 0, None
    for pieces in planes:
        if not len(pieces.frame):
            continue
        turned = np.abs(pieces.direction @ pieces.direction.T)
        apart = pieces.middle[np.newaxis] - pieces.middle[:, np.newaxis]
        off_m = np.abs(apart[..., 0] * pieces.direction[:, 1:] - apart[..., 1] * pieces.direction[:, :1])
        near_m = _MAX_AWAY_M + _AWAY_SD * shift_sd_m
        alike = (turned >= np.cos(np.radians(_MAX_TURN_DEG))) & (np.maximum(off_m, off_m.T) <= near_m)
        seed = int(np.argmax(alike.sum(axis=1)))
        if alike[seed].sum() > most:
            most, best = int(alike[seed].sum()), pieces.take(alike[seed])
    return best


def _most_common(tracks: Ints) -> int:
    ids, counts = np.unique(tracks, return_counts=True)
    return int(ids[np.argmax(counts)])


def _frames_showing(sight: SpanSight, found: _Pieces, rules: Rules) -> tuple[Mask, Mask]:
    """Return which frames (N,) show some of a found line, and which enough that its line should be found."""
    doubled = np.exp(2j * np.arctan2(found.direction[:, 1], found.direction[:, 0])).mean()
    turn = np.angle(doubled) / 2
    along, middle = np.array((np.cos(turn), np.sin(turn))), np.median(found.middle, axis=0)
    centre_m = (found.middle - middle) @ along
    ends = np.quantile(centre_m - found.half_m, _ENDS), np.quantile(centre_m + found.half_m, 1 - _ENDS)
    away_m = np.concatenate((_SHOWN_M, np.linspace(*ends, _N_POINTS)))
    places = middle + away_m[:, np.newaxis] * along
    ground = sight.axis.start + places @ np.stack((sight.axis.along, sight.axis.across))
    points = np.column_stack((ground, np.full(len(ground), found.height_m)))
    shown = np.isfinite(visible_gsd_m(sight.cameras, points, rules.anomalies["margin_px"]))
    n_shown = shown[:, len(_SHOWN_M) :].sum(axis=1)
    is_shown = n_shown > _SHOWN_SHARE * n_shown.max()
    return np.asarray(is_shown), np.asarray(shown[:, : len(_SHOWN_M)].all(axis=1))
