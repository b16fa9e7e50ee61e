"""Anomalies and coverage against simulated flights whose truth is known, and against real ones without lines.

    python benchmarks/bench_inspection.py [--seeds 20] [--first-seed 1000] [--jobs 2] [--kinds blur dark ...]

Of each kind of anomaly one case a seed is planted into a flight of 40 s at 4 frames a second, and as
many flights have none. The true lines are disturbed: 2 px of noise on every point, one in ten missed,
one false line a frame. They go the way of all lines, over parquet files and the index. A hit is an
anomaly of the kind whose interval and that of the truth have an intersection of at least half their
union. Coverage is measured on the flights without faults, by true and by disturbed lines. With
LSNET_PIPE_DATA, two real flights without lines are processed. The exit code is 1 when a bar is missed;
the last line is one JSON object.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from collections import Counter, defaultdict
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from inspect_pipeline import index
from inspect_pipeline.config import ProcessOptions, start_run
from inspect_pipeline.pipeline import process
from inspect_pipeline.simulate_options import FaultKind, FlightKind, SimulationOptions
from inspect_pipeline.simulate_plan import plan_flight
from inspect_pipeline.simulate_truth import truth_of
from inspect_pipeline.spans import import_spans
from inspect_pipeline.store import Store
from lsnet import Detector

sys.path.append(str(Path(__file__).parents[1] / "tests"))
import inspected  # after lsnet, of which the tests have a folder too

if TYPE_CHECKING:
    from collections.abc import Iterable

    from inspect_pipeline.simulate_plan import FlightPlan
    from inspect_pipeline.simulate_types import FlightTruth

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
SECONDS, FPS = 40.0, 4.0
MIN_IOU, MIN_RECALL, MIN_PRECISION, MAX_ERROR_POINTS = 0.5, 0.95, 0.90, 1.0
PATH_STEP_M = 0.05


@dataclass(frozen=True)
class Case:
    """A flight to simulate: the fault in it, or none and how it is flown."""

    seed: int
    fault: FaultKind | None
    flight: FlightKind = FlightKind.PASS_BY


@dataclass(frozen=True)
class Outcome:
    """What was found: hits of the planted kind, other findings by kind, errors of coverage in points."""

    case: Case
    n_planted: int
    n_hits: int
    others: Counter[str]
    errors: dict[str, list[float]]


def run_case(case: Case) -> Outcome:
    """Simulate a flight, put it into a store, and compare what the index says with the truth."""
    faults = () if case.fault is None else (case.fault,)
    plan = plan_flight(SimulationOptions(SECONDS, FPS, seed=case.seed, flight=case.flight, faults=faults))
    truth = truth_of(plan)
    with tempfile.TemporaryDirectory() as folder:
        rows = inspect(Path(folder) / "disturbed", truth, np.random.default_rng(case.seed))
        errors = {}
        if case.fault is None:
            wanted = true_coverage(plan, truth)
            errors = {f"{name} disturbed": error for name, error in coverage_errors(rows, wanted).items()}
            errors |= coverage_errors(inspect(Path(folder) / "true", truth, None), wanted)
    hits, others = match(truth, rows["anomalies"])
    return Outcome(case, len(truth.faults), hits, others, errors)


def inspect(folder: Path, truth: FlightTruth, rng: np.random.Generator | None) -> dict[str, Any]:
    """The rows of anomalies and coverage that the index has of a flight."""
    store = Store(folder)
    inspected.write_truth(store, "flight", truth, rng)
    import_spans(store, inspected.spans_of(truth))
    index.publish(store)
    anomalies = index.select(store, "SELECT kind, start_ns, end_ns FROM anomalies ORDER BY ALL")
    coverage = index.select(store, "SELECT kind, unit, span_id, share FROM coverage WHERE channel_id IS NULL")
    return {"anomalies": anomalies, "coverage": coverage}


def match(truth: FlightTruth, anomalies: list[dict[str, Any]]) -> tuple[int, Counter[str]]:
    """How many planted faults were found, and what else was, by kind."""
    hits = 0
    for fault in truth.faults:
        same = [one for one in anomalies if one["kind"] == KINDS[fault.kind]]
        best = max(same, key=lambda one: overlap(one, fault.start_ns, fault.end_ns), default=None)
        if best is not None and overlap(best, fault.start_ns, fault.end_ns) >= MIN_IOU:
            hits += 1
            anomalies.remove(best)
    return hits, Counter(one["kind"] for one in anomalies)


def overlap(found: dict[str, Any], start_ns: int, end_ns: int) -> float:
    """Intersection over union of two intervals."""
    common = min(found["end_ns"], end_ns) - max(found["start_ns"], start_ns)
    whole = max(found["end_ns"], end_ns) - min(found["start_ns"], start_ns)
    return max(0, common) / whole if whole else 1.0


def true_coverage(plan: FlightPlan, truth: FlightTruth) -> dict[tuple[str, str | None], float]:
    """What the four kinds of coverage are by the truth, in shares."""
    recorded = [frame for frame in truth.frames if not frame.dropped]
    good = [frame for frame in recorded if frame.quality == "ok"]
    seen = [frame for frame in good if any(line.span_id for line in frame.lines)]
    shares: dict[tuple[str, str | None], float] = {
        ("frame", None): len(good) / len(truth.frames),
        ("detection", None): len(seen) / len(truth.frames),
        ("corridor", None): true_corridor(plan, truth),
    }
    return shares | {("span", span_id): share for span_id, share in truth.span_coverage.items()}


def true_corridor(plan: FlightPlan, truth: FlightTruth) -> float:
    """The share of the ground below the path that good frames with lines show, every few centimetres."""
    shots = [shot for shot in plan.shots() if not shot.is_dropped]
    good = [frame.quality == "ok" and bool(frame.lines) for frame in truth.frames if not frame.dropped]
    path = np.array([plan.pose(shot.time_ns).position[:2] for shot in shots])
    walked = np.concatenate(([0.0], np.hypot(*np.diff(path, axis=0).T).cumsum()))
    if walked[-1] < 1:
        return float("nan")
    at = np.arange(PATH_STEP_M / 2, walked[-1], PATH_STEP_M)
    places = np.column_stack([*(np.interp(at, walked, column) for column in path.T), np.zeros(len(at))])
    is_seen = np.zeros(len(at), bool)
    for shot, is_good in zip(shots, good, strict=True):
        if is_good:
            camera = plan.camera(shot.time_ns)
            range_m = np.linalg.norm(places - camera.position, axis=1)
            is_seen |= camera.sees(*camera.project(places)) & (range_m <= 0.05 * camera.focal_px)
    return float(is_seen.mean())


def coverage_errors(
    rows: dict[str, Any], wanted: dict[tuple[str, str | None], float]
) -> dict[str, list[float]]:
    """By kind, how far shares are from the truth, in percentage points; spans that are not near have 0."""
    found = {
        (row["kind"], row["span_id"]): row["share"]
        for row in rows["coverage"]
        if not (row["kind"] == "detection" and row["unit"] == "m")
    }
    errors = defaultdict(list)
    for (kind, span_id), share in wanted.items():
        if np.isfinite(share):
            errors[kind].append(100 * abs((found.get((kind, span_id)) or 0.0) - share))
    return dict(errors)


def real_flights() -> dict[str, dict[str, int]] | None:
    """Anomalies by kind of two real flights over ground without lines, by the shipped weights."""
    folder = os.environ.get("LSNET_PIPE_DATA")
    if folder is None:
        return None
    detector, options = Detector.load(), ProcessOptions()
    found = {}
    for name in ("caliterra_foxglove", "brighton_ros2"):
        with tempfile.TemporaryDirectory() as scratch:
            store = Store(Path(scratch))
            run = start_run(detector, options)
            process(Path(folder) / "mcap" / f"{name}.mcap", store, detector, options, run)
            index.publish(store)
            rows = index.select(store, "SELECT kind, count(*) AS n FROM anomalies GROUP BY kind")
        found[name] = {row["kind"]: row["n"] for row in rows}
    return found


def cases_of(args: argparse.Namespace) -> list[Case]:
    seeds = range(args.first_seed, args.first_seed + args.seeds)
    kinds = [FaultKind(name) for name in args.kinds] if args.kinds else list(KINDS)
    flown = list(FlightKind)
    planted = [Case(seed, kind) for kind in kinds for seed in seeds]
    return [*planted, *(Case(seed + 500, None, flown[seed % len(flown)]) for seed in seeds)]


def summarize(outcomes: Iterable[Outcome]) -> dict[str, Any]:
    """Recall, precision and false alarms by kind, and the mean errors of coverage."""
    outcomes = list(outcomes)
    clean = [one for one in outcomes if one.case.fault is None]
    in_clean = sum((one.others for one in clean), Counter[str]())
    kinds = {}
    for fault in dict.fromkeys(one.case.fault for one in outcomes if one.case.fault):
        kind = KINDS[fault]
        own = [one for one in outcomes if one.case.fault == fault]
        hits, planted = sum(one.n_hits for one in own), sum(one.n_planted for one in own)
        false = sum(one.others[kind] for one in own) + in_clean[kind]
        elsewhere = sum(one.others[kind] for one in outcomes if one.case.fault not in {fault, None})
        kinds[kind] = {
            "planted": planted,
            "recall": round(hits / planted, 4) if planted else None,
            "precision": round(hits / (hits + false), 4) if hits + false else None,
            "false_in_clean": in_clean[kind],
            "false_beside_other_faults": elsewhere,
        }
    names = [f"{name}{suffix}" for name in COVERAGES for suffix in ("", " disturbed")]
    errors = {name: [e for one in clean for e in one.errors.get(name, [])] for name in names}
    return {
        "kinds": kinds,
        "clean_flights": len(clean),
        "coverage_error_points": {name: round(float(np.mean(e)), 3) for name, e in errors.items() if e},
    }


def missed_bars(result: dict[str, Any]) -> list[str]:
    missed = []
    for kind, scores in result["kinds"].items():
        for name, bar in (("recall", MIN_RECALL), ("precision", MIN_PRECISION)):
            if scores[name] is None or scores[name] < bar:
                missed.append(f"{name} of {kind} is {scores[name]}, not {bar}")
    for name in COVERAGES:
        error = result["coverage_error_points"].get(name)
        if error is not None and error > MAX_ERROR_POINTS:
            missed.append(f"error of {name} coverage is {error} points, not {MAX_ERROR_POINTS}")
    for flight, found in (result["real_flights"] or {}).items():
        if odd := [kind for kind in found if kind in ABOUT_CONDUCTORS]:
            missed.append(f"{flight} has {', '.join(odd)}")
    return missed


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first-seed", type=int, default=1000)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--kinds", nargs="*", choices=[str(kind) for kind in KINDS], metavar="KIND")
    args = parser.parse_args()
    started = time.perf_counter()
    outcomes = []
    with ProcessPoolExecutor(args.jobs) as pool:
        for one in pool.map(run_case, cases_of(args)):
            outcomes.append(one)
            if one.n_hits < one.n_planted or one.others:
                name = one.case.fault or f"clean, {one.case.flight}"
                print(
                    f"seed {one.case.seed} {name}: {one.n_hits} of {one.n_planted}, else {dict(one.others)}"
                )
    result = summarize(outcomes) | {"real_flights": real_flights()}
    result["missed"] = missed_bars(result)
    for kind, scores in result["kinds"].items():
        print(f"{kind:22} {scores}")
    result["seconds"] = round(time.perf_counter() - started, 1)
    print(json.dumps(result))
    return 1 if result["missed"] else 0


if __name__ == "__main__":
    sys.exit(main())
