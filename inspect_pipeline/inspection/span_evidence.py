"""Evidence about the conductors of spans: where each is present, by the votes of all frames that show it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import median_filter

from inspect_pipeline.inspection.conductors.placing import find_mixed, place_conductors
from inspect_pipeline.inspection.conductors.sight import look_at_span
from inspect_pipeline.inspection.conductors.votes import count_votes
from inspect_pipeline.inspection.judgement import judge_bins
from inspect_pipeline.inspection.lines import confirmed_lines, number_untracked
from inspect_pipeline.inspection.poses import camera_poses, find_pose_problems
from inspect_pipeline.inspection.rows import find_runs
from inspect_pipeline.inspection.span_view import make_axis, near_path, select_frames, visible_gsd_m
from inspect_pipeline.inspection.terrain import find_ground

if TYPE_CHECKING:
    from collections.abc import Sequence

    from inspect_pipeline.arrays import Floats, Ints, Mask
    from inspect_pipeline.geometry.camera import CameraPoses
    from inspect_pipeline.geometry.local_frame import LocalMetres
    from inspect_pipeline.inspection.conductors.layout import Place
    from inspect_pipeline.inspection.conductors.placing import Placing
    from inspect_pipeline.inspection.conductors.sight import SpanSight
    from inspect_pipeline.inspection.conductors.votes import Votes
    from inspect_pipeline.inspection.rows import CameraRows, LineRows
    from inspect_pipeline.inspection.rules import Rules
    from inspect_pipeline.inspection.span_view import SpanAxis
    from inspect_pipeline.inspection.spans import Span

_MAX_FRAMES = 300  # of a span: more are thinned out, as neighbours show the same
_POINTS_A_BIN = 4  # to count how much frames show
_SMOOTHED_SHARE = 40  # of the frames, one: on each side, over which the median of that is taken
_MAX_HIDDEN = 0.5  # of the views of a conductor, which another one spoils
_MIN_PRESENT = 0.4  # of the votes; with fewer, and too few against it, frames disagree
PRESENT, ABSENT, UNKNOWN = 1, 0, -1


@dataclass(frozen=True, eq=False)
class SpanEvidence:
    """Evidence about the K conductors of a span of B bins.

    places: where they hang, alike on all spans. states (K, B): PRESENT, ABSENT or UNKNOWN.
    votes: None without any place. outcome (B,): what is in the way of judging a bin at all, see `judgement`.
    explained: share of what lines show along the spans of the line that the conductors explain.
    """

    sight: SpanSight
    places: tuple[Place, ...]
    votes: Votes | None
    states: Ints
    outcome: Ints
    explained: float

    @property
    def axis(self) -> SpanAxis:
        return self.sight.axis

    def rows_showing(self, bins: Ints, places: Sequence[Place] = ()) -> Ints:
        """Return the longest run of usable frames that show half of a stretch, or of what any shows.

        bins: its first and last one count. places: of conductors that the stretch is one of, else it is one
        of the axis. How finely a frame shows it does not matter.
        """
        sight = self.sight
        lines = [sight.points_of(place) for place in places] or [self.axis.centres]
        points = np.concatenate([_along(line, bins) for line in lines])
        shown = np.isfinite(visible_gsd_m(sight.cameras, points))
        usable = np.flatnonzero(np.isfinite(sight.from_m))
        n_shown = shown[usable].sum(axis=1, dtype=np.float64)
        if not sight.is_exact:  # else errors of single poses would break a visit in pieces
            n_shown = median_filter(n_shown, 1 + 2 * (len(usable) // _SMOOTHED_SHARE), mode="nearest")
        longest = usable[max(find_runs(n_shown >= n_shown.max() / 2, 1), key=len)]
        return np.arange(sight.rows[longest[0]], sight.rows[longest[-1]] + 1)

    def place(self, bins: Ints, origin: LocalMetres) -> tuple[float, float]:
        """Return latitude and longitude of the middle of some bins."""
        lat_deg, lon_deg = origin.to_degrees(self.axis.centres[bins, :2].mean(axis=0))
        return float(lat_deg), float(lon_deg)

    @property
    def is_present(self) -> Mask:
        """Where conductors are present (K, B)."""
        return np.asarray(self.states == PRESENT)

    @property
    def is_judged(self) -> Mask:
        """Where it is known whether conductors are present (K, B)."""
        return np.asarray(self.states != UNKNOWN)


def _along(centres: Floats, bins: Ints) -> Floats:
    """Return points along a line of bins with centres (B, 3), from the edge of one bin to that of another."""
    n_points = _POINTS_A_BIN * int(bins[-1] - bins[0] + 1) + 1
    at = np.linspace(bins[0] - 0.5, bins[-1] + 0.5, n_points)
    return np.column_stack([np.interp(at, np.arange(len(centres)), column) for column in centres.T])


def gather_evidence(
    camera: CameraRows, spans: Sequence[Span], origin: LocalMetres, is_usable: Mask, rules: Rules
) -> list[SpanEvidence]:
    """Return the evidence about each span near the path of a camera."""
    lines = evidence_lines(camera, rules)
    ground = find_ground([camera], origin)
    cameras = camera_poses(camera.frames, origin, rules)
    problems = find_pose_problems(camera.frames, is_usable, rules)
    cameras.positions[~is_usable] = np.nan
    path = origin.to_metres(camera.frames.lat_deg, camera.frames.lon_deg)
    known = np.isfinite(path).all(axis=1)
    sights: dict[str | None, list[SpanSight]] = {}
    for span in spans:
        axis = make_axis(span, origin, rules, ground)
        if near_path(axis.centres[:, :2], path[known], rules.coverage["near_m"]).any():
            sights.setdefault(span.line_id, []).append(_look(axis, cameras, lines, rules))
    evidence = []
    for group in sights.values():
        found = place_conductors(group, rules)
        near_problems = path[known], problems[known]
        evidence += [_judge_span(one, found, near_problems, rules) for one in found.sights]
    return evidence


def share_missed(evidence: Sequence[SpanEvidence]) -> float:
    """Return the share of conductors that frames miss, of those frames that have a part of their lines."""
    missed = shown = 0.0
    for one in evidence:
        if one.votes is not None:
            in_frame = one.votes.in_frame[:, :, np.newaxis]
            is_open = one.states != ABSENT
            missed += float((one.votes.against * in_frame).sum(axis=0)[is_open].sum())
            shown += float((one.votes.weight * in_frame).sum(axis=0)[is_open].sum())
    return missed / max(shown, 1e-9)


def evidence_lines(camera: CameraRows, rules: Rules) -> LineRows:
    """Return lines confirmed by tracks; of photographs all lines. Those without one have ids of their own."""
    is_video = camera.cadence(rules).is_video
    return number_untracked(confirmed_lines(camera.lines, rules) if is_video else camera.lines)


def _look(axis: SpanAxis, cameras: CameraPoses, lines: LineRows, rules: Rules) -> SpanSight:
    """Return the sight of a span by the frames that show it, thinned out where they are very many."""
    frames = select_frames(axis.centres, cameras, lines)
    rows = np.arange(frames.rows.start, frames.rows.stop)
    if len(rows) <= _MAX_FRAMES:
        return look_at_span(axis, rows, frames.cameras, frames.lines, rules)
    kept = np.unique(np.linspace(0, len(rows) - 1, _MAX_FRAMES).round().astype(np.int64))
    number = np.full(len(rows), -1)
    number[kept] = np.arange(len(kept))
    chosen = frames.lines.take(np.flatnonzero(number[frames.lines.frame] >= 0))
    return look_at_span(
        axis, rows[kept], frames.cameras[kept], chosen.with_frames(number[chosen.frame]), rules
    )


def _judge_span(
    sight: SpanSight, found: Placing, path_problems: tuple[Floats, Ints], rules: Rules
) -> SpanEvidence:
    places = found.places
    shape = len(places), len(sight.axis.centres)
    states, votes = np.full(shape, UNKNOWN), None
    if places:
        votes = count_votes(sight, places, rules)
        states = _decide(votes, rules)
        mixed = find_mixed(found)
        states[mixed] = UNKNOWN
        votes.hidden[mixed] = 1.0
    is_judged = (states != UNKNOWN).any(axis=0)
    outcome = judge_bins(sight.axis, is_judged, (sight.shown, sight.coarse), path_problems, rules)
    return SpanEvidence(sight, tuple(places), votes, states, outcome, found.explained)


def _decide(votes: Votes, rules: Rules) -> Ints:
    """Return the state (K, B) of each conductor in each bin by the weight of the votes."""
    total, against = votes.weight.sum(axis=0), votes.against.sum(axis=0)
    limits = rules.anomalies
    absent = against >= np.maximum(limits["min_support"], limits["min_agreement"] * total)
    present = total - against >= _MIN_PRESENT * total
    states = np.where(absent, ABSENT, np.where(present, PRESENT, UNKNOWN))
    is_unknown = (total < limits["min_evidence"]) | (votes.hidden > _MAX_HIDDEN)
    return np.where(is_unknown, UNKNOWN, states)
