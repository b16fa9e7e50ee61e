"""What the index says of a simulated flight against its truth: planted faults, conductors, coverage."""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from inspect_pipeline.simulation.options import FaultKind

if TYPE_CHECKING:
    from inspect_pipeline.simulation.plan import FlightPlan
    from inspect_pipeline.simulation.records import FaultTruth, FlightTruth

KINDS = {
    FaultKind.MISSING_CONDUCTOR: "conductor_count",
    FaultKind.BROKEN_CONDUCTOR: "conductor_lost",
    FaultKind.CONDUCTOR_GAP: "conductor_gap",
    FaultKind.SAG_OUTLIER: "sag_change",
    FaultKind.CONDUCTORS_TOO_CLOSE: "conductors_converging",
    FaultKind.CROSSING_LINE: "crossing_line",
    FaultKind.BLUR: "blurred_frames",
    FaultKind.DARK: "dark_frames",
    FaultKind.OVEREXPOSED: "overexposed_frames",
    FaultKind.DROPOUT: "sensor_dropout",
    FaultKind.GPS_GAP: "stale_pose",
    FaultKind.CLOCK_STEP: "clock_step",
    FaultKind.ORIENTATION_JUMP: "orientation_jump",
}
ABOUT_CONDUCTORS = [kind for fault, kind in KINDS.items() if fault in tuple(FaultKind)[:6]]
COVERAGES = ("frame", "detection", "span", "corridor")
_MIN_IOU = 0.5
_NOMINAL_M = 11.7  # height of conductors in the spans file
_PATH_STEP_M = 0.05
_MAX_GSD_M = 0.05  # coarser pixels show nothing, by the shipped rules
_FAR_M = 2.0  # of a conductor from its row: farther away counts no more
_SHIFT_COST = 0.1  # of errors of positions, for each metre


def match(truth: FlightTruth, anomalies: list[dict[str, Any]]) -> tuple[int, Counter[str]]:
    """How many planted faults were found, and what else was, by kind."""
    hits, others = 0, list(anomalies)
    for fault in truth.faults:
        same = [one for one in others if one["kind"] == KINDS[fault.kind]]
        best = max(same, key=lambda one: _overlap(one, fault.start_ns, fault.end_ns), default=None)
        if best is not None and _overlap(best, fault.start_ns, fault.end_ns) >= _MIN_IOU:
            hits += 1
            others.remove(best)
    return hits, Counter(one["kind"] for one in others)


def _overlap(found: dict[str, Any], start_ns: int, end_ns: int) -> float:
    """Intersection over union of two intervals."""
    common = min(found["end_ns"], end_ns) - max(found["start_ns"], start_ns)
    whole = max(found["end_ns"], end_ns) - min(found["start_ns"], start_ns)
    return max(0, common) / whole if whole else 1.0


def true_coverage(plan: FlightPlan, truth: FlightTruth) -> dict[tuple[str, str | None], float]:
    """What the four kinds of coverage are by the truth, in shares, where pixels are fine enough to count."""
    recorded = [frame for frame in truth.frames if not frame.dropped]
    good = [frame for frame in recorded if frame.quality == "ok"]
    seen = [frame for frame in good if any(line.span_id for line in frame.lines)]
    shares: dict[tuple[str, str | None], float] = {
        ("frame", None): len(good) / len(truth.frames),
        ("detection", None): len(seen) / len(truth.frames),
        ("corridor", None): _true_corridor(plan, truth),
    }
    return shares | _true_spans(plan, truth)


def _true_spans(plan: FlightPlan, truth: FlightTruth) -> dict[tuple[str, str | None], float]:
    """The share of the axis of each span that good frames show."""
    is_seen = np.zeros(len(plan.axis), bool)
    for shot, frame in zip(plan.shots(), truth.frames, strict=True):
        if frame.quality == "ok" and not frame.dropped:
            camera = plan.camera(shot.time_ns)
            seen = plan.axis_seen(camera)
            range_m = np.linalg.norm(plan.axis[seen] - camera.position, axis=1)
            is_seen[seen[range_m <= _MAX_GSD_M * camera.focal_px]] = True
    shares = plan.shares_of_spans(is_seen).tolist()
    return {("span", plan.span_id(i)): share for i, share in enumerate(shares)}


def _true_corridor(plan: FlightPlan, truth: FlightTruth) -> float:
    """The share of the ground below the path that good frames with lines show, every few centimetres."""
    shots = [shot for shot in plan.shots() if not shot.is_dropped]
    good = [frame.quality == "ok" and bool(frame.lines) for frame in truth.frames if not frame.dropped]
    path = np.array([plan.pose(shot.time_ns).position[:2] for shot in shots])
    walked = np.concatenate(([0.0], np.hypot(*np.diff(path, axis=0).T).cumsum()))
    if walked[-1] < 1:
        return float("nan")
    at = np.arange(_PATH_STEP_M / 2, walked[-1], _PATH_STEP_M)
    below = np.column_stack([np.interp(at, walked, column) for column in path.T])
    places = np.column_stack((below, plan.line.route.ground_m(below[:, 0])))
    is_seen = np.zeros(len(at), bool)
    for shot, is_good in zip(shots, good, strict=True):
        if is_good:
            camera = plan.camera(shot.time_ns)
            range_m = np.linalg.norm(places - camera.position, axis=1)
            is_seen |= camera.sees(*camera.project(places)) & (range_m <= _MAX_GSD_M * camera.focal_px)
    return float(is_seen.mean())


def coverage_errors(
    rows: list[dict[str, Any]], wanted: dict[tuple[str, str | None], float]
) -> dict[str, list[float]]:
    """By kind, how far shares are from the truth, in percentage points; spans that are not near have 0."""
    found = {
        (row["kind"], row["span_id"]): row["share"]
        for row in rows
        if not (row["kind"] == "detection" and row["unit"] == "m")
    }
    errors = defaultdict(list)
    for (kind, span_id), share in wanted.items():
        if np.isfinite(share):
            errors[kind].append(100 * abs((found.get((kind, span_id)) or 0.0) - share))
    return dict(errors)


@dataclass(frozen=True)
class UnknownCoverage:
    """Metres of spans near a flight, all and unknown, and how many spans are unknown but shown as 0."""

    total_m: float
    unknown_m: float
    shown_as_zero: int


def unknown_coverage(rows: list[dict[str, Any]]) -> UnknownCoverage:
    """How much of the spans near a flight is said to be unknown."""
    spans = [row for row in rows if row["kind"] == "span" and row["total"] is not None]
    return UnknownCoverage(
        total_m=sum(row["total"] for row in spans),
        unknown_m=sum(row["unknown"] for row in spans),
        shown_as_zero=sum(row["unknown"] >= row["total"] and row["share"] is not None for row in spans),
    )


def is_judged(plan: FlightPlan, truth: FlightTruth, fault: FaultTruth, rows: dict[str, Any]) -> bool:
    """Whether the index says that it judged what a fault is about.

    That is half of what the flight shows of its span, by the truth, and of its conductor. Rules about frames
    always judge.
    """
    kind = KINDS[fault.kind]
    if fault.span_id is None or kind == "crossing_line":
        return True
    own = [row for row in rows["judged"] if (row["span_id"], row["kind"]) == (fault.span_id, kind)]
    in_view = truth.span_coverage[fault.span_id]
    if not own or own[0]["judged_m"] < own[0]["length_m"] * in_view / 2:
        return False
    matched = _match_conductors(plan, [row for row in rows["conductors"] if row["span_id"] == fault.span_id])
    if kind == "conductors_converging":
        pair = [matched.get(name) for name in fault.conductor_ids]
        return all(row is not None and row["judged_m"] >= own[0]["judged_m"] / 2 for row in pair)
    row = matched.get(fault.conductor_ids[0])
    if kind == "sag_change":
        return row is not None and row["sag_m"] is not None
    if row is None:
        return kind == "conductor_count"  # the index judged the number without a place of the missing one
    return row["judged_m"] >= own[0]["judged_m"] / 2


def _match_conductors(plan: FlightPlan, rows: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """The rows of a span by the conductor of the truth that each is nearest to, errors of positions apart.

    Those move all conductors alike, by as much as lets most of them agree: some may have no row.
    """
    if not rows:
        return {}
    hung = [_hung(plan, c.conductor_id, rows[0]["span_id"]) for c in plan.line.conductors]
    true = np.array([one[:2] for one in hung])
    found = np.array([(row["across_m"], row["raised_m"]) for row in rows])
    apart = true[:, np.newaxis] - found
    shifts = apart.reshape(-1, 2)
    away = np.minimum(np.linalg.norm(apart - shifts[:, np.newaxis, np.newaxis], axis=3), _FAR_M)
    pairs = [linear_sum_assignment(one) for one in away]
    totals = [one[pair].sum() for one, pair in zip(away, pairs, strict=True)]
    best = int(np.argmin(totals + _SHIFT_COST * np.linalg.norm(shifts, axis=1)))
    return {plan.line.conductors[i].conductor_id: rows[j] for i, j in zip(*pairs[best], strict=True)}


def conductor_errors(plan: FlightPlan, rows: list[dict[str, Any]]) -> dict[str, list[float]]:
    """Errors in metres of heights, relative to the structures, and of sags, of healthy conductors."""
    faulty = {name for fault in plan.planted for name in fault.conductor_ids}
    errors: dict[str, list[float]] = {"height_m": [], "sag_m": []}
    for span_id in {row["span_id"] for row in rows}:
        own = [row for row in rows if row["span_id"] == span_id]
        for name, row in _match_conductors(plan, own).items():
            if row["sag_m"] is not None and name not in faulty:
                _, raised_m, sag_m = _hung(plan, name, span_id)
                errors["height_m"].append(abs(row["raised_m"] + _NOMINAL_M - raised_m))
                errors["sag_m"].append(abs(row["sag_m"] - sag_m))
    return errors


def _hung(plan: FlightPlan, conductor_id: str, span_id: str) -> tuple[float, float, float]:
    """How far left of a span's axis and above its structures' feet a conductor hangs, and its sag, in m."""
    line = plan.line
    span = next(i for i in range(line.n_structures - 1) if plan.span_id(i) == span_id)
    first, last = np.searchsorted(line.along, line.structures_along[span : span + 2]).tolist()
    points = line[conductor_id].points[first : last + 1]
    feet = np.array([one.foot for one in line.structures[span : span + 2]])
    ahead = (feet[1] - feet[0])[:2] / np.hypot(*(feet[1] - feet[0])[:2])
    ends = points[[0, -1]] - feet
    chord_m = np.interp(np.arange(len(points)), (0, len(points) - 1), points[[0, -1], 2])
    left_m = ends[:, :2] @ (-ahead[1], ahead[0])
    return float(left_m.mean()), float(ends[:, 2].mean()), float((chord_m - points[:, 2]).max())
