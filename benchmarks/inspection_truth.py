"""Compare the index of a simulated flight with its ground truth: hits and errors of coverage."""

from __future__ import annotations

from collections import Counter, defaultdict
from typing import TYPE_CHECKING, Any

import numpy as np

from inspect_pipeline.simulation.options import FaultKind

if TYPE_CHECKING:
    from inspect_pipeline.simulation.plan import FlightPlan
    from inspect_pipeline.simulation.records import FlightTruth

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
_PATH_STEP_M = 0.05


def match(truth: FlightTruth, anomalies: list[dict[str, Any]]) -> tuple[int, Counter[str]]:
    """Return how many planted faults were found, and the other findings by kind."""
    hits, others = 0, list(anomalies)
    for fault in truth.faults:
        same = [one for one in others if one["kind"] == KINDS[fault.kind]]
        best = max(same, key=lambda one: _overlap(one, fault.start_ns, fault.end_ns), default=None)
        if best is not None and _overlap(best, fault.start_ns, fault.end_ns) >= _MIN_IOU:
            hits += 1
            others.remove(best)
    return hits, Counter(one["kind"] for one in others)


def _overlap(found: dict[str, Any], start_ns: int, end_ns: int) -> float:
    """Return the intersection over union of two intervals."""
    common = min(found["end_ns"], end_ns) - max(found["start_ns"], start_ns)
    whole = max(found["end_ns"], end_ns) - min(found["start_ns"], start_ns)
    return max(0, common) / whole if whole else 1.0


def true_coverage(plan: FlightPlan, truth: FlightTruth) -> dict[tuple[str, str | None], float]:
    """Return the four kinds of coverage by the ground truth, as shares."""
    recorded = [frame for frame in truth.frames if not frame.dropped]
    good = [frame for frame in recorded if frame.quality == "ok"]
    seen = [frame for frame in good if any(line.span_id for line in frame.lines)]
    shares: dict[tuple[str, str | None], float] = {
        ("frame", None): len(good) / len(truth.frames),
        ("detection", None): len(seen) / len(truth.frames),
        ("corridor", None): _true_corridor(plan, truth),
    }
    return shares | {("span", span_id): share for span_id, share in truth.span_coverage.items()}


def _true_corridor(plan: FlightPlan, truth: FlightTruth) -> float:
    """Return the share of the ground below the path that good frames with lines show."""
    shots = [shot for shot in plan.shots() if not shot.is_dropped]
    good = [frame.quality == "ok" and bool(frame.lines) for frame in truth.frames if not frame.dropped]
    path = np.array([plan.pose(shot.time_ns).position[:2] for shot in shots])
    walked = np.concatenate(([0.0], np.hypot(*np.diff(path, axis=0).T).cumsum()))
    if walked[-1] < 1:
        return float("nan")
    at = np.arange(_PATH_STEP_M / 2, walked[-1], _PATH_STEP_M)
    places = np.column_stack([*(np.interp(at, walked, column) for column in path.T), np.zeros(len(at))])
    is_seen = np.zeros(len(at), bool)
    for shot, is_good in zip(shots, good, strict=True):
        if is_good:
            camera = plan.camera(shot.time_ns)
            range_m = np.linalg.norm(places - camera.position, axis=1)
            is_seen |= camera.sees(*camera.project(places)) & (range_m <= 0.05 * camera.focal_px)
    return float(is_seen.mean())


def coverage_errors(
    rows: list[dict[str, Any]], wanted: dict[tuple[str, str | None], float]
) -> dict[str, list[float]]:
    """Return errors of shares in percentage points by kind; spans that are not near have 0."""
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
