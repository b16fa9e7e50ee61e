"""Measure anomalies and coverage on simulated flights with ground truth, and on real ones without lines.

    python benchmarks/bench_inspection.py [--seeds 20] [--drawn 2] [--first-seed 1000] [--jobs 2]
        [--kinds blur dark ...] [--flights 1000]

For each seed and each kind of anomaly, one fault is planted into a flight of 40 s at 4 frames a second. As
many flights, at least four, have no fault. The true lines are disturbed (2 px of noise on every point, one in
ten missed, one false line a frame) and pass through parquet files and the index like all lines. A hit is an
anomaly of the kind whose interval overlaps the true one by at least half of their union. Coverage is measured
on the flights without faults, with true and with disturbed lines. For the first --drawn seeds, flights of
20 s are drawn in 640 x 360 px and processed with the shipped weights. With LSNET_PIPE_DATA, two real flights
without lines are processed. Finally the documented queries are timed on an index of --flights, see
bench_queries.py. The exit code is 1 when a bar is missed; the last line is one JSON object.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from bench_queries import measure_queries
from inspection_cases import Case, Outcome, put_recording, run_case
from inspection_truth import ABOUT_CONDUCTORS, COVERAGES, KINDS

from inspect_pipeline.index import publish as index
from inspect_pipeline.index.reading import select
from inspect_pipeline.simulation.options import FaultKind, FlightKind
from inspect_pipeline.store.store import Store

if TYPE_CHECKING:
    from collections.abc import Iterator

MIN_RECALL, MIN_PRECISION = 0.95, 0.90
MAX_ERROR_POINTS = {"": 1.0, " detector": 5.0}
WAYS = ("", " disturbed", " detector")


def cases_of(args: argparse.Namespace) -> Iterator[Case]:
    """Yield the flights; drawn ones first, because they take longest."""
    kinds = [FaultKind(name) for name in args.kinds] if args.kinds else list(KINDS)
    flown = list(FlightKind)
    for is_drawn, n_seeds in ((True, args.drawn), (False, args.seeds)):
        if n_seeds:
            clean = range(args.first_seed, args.first_seed + max(n_seeds, len(flown)))
            yield from (Case(seed + 500, None, flown[seed % len(flown)], is_drawn) for seed in clean)
            planted = range(args.first_seed, args.first_seed + n_seeds)
            yield from (Case(seed, kind, is_drawn=is_drawn) for kind in kinds for seed in planted)


def run_cases(args: argparse.Namespace) -> list[Outcome]:
    """Return the outcomes of all cases; print missed and false findings."""
    outcomes = []
    with ProcessPoolExecutor(args.jobs) as pool:
        for one in pool.map(run_case, cases_of(args)):
            outcomes.append(one)
            if one.case.is_drawn and one.errors:
                print(f"{one.case}: {one.errors}", flush=True)
            if one.n_hits < one.n_planted or one.others:
                print(f"{one.case}: {one.n_hits} of {one.n_planted}, else {dict(one.others)}", flush=True)
    return outcomes


def scores_by_kind(outcomes: list[Outcome]) -> dict[str, dict[str, Any]]:
    """Return recall, precision and false alarms by kind."""
    in_clean = sum((one.others for one in outcomes if one.case.fault is None), Counter[str]())
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
    return kinds


def mean_errors(outcomes: list[Outcome]) -> dict[str, float]:
    """Return the mean errors of coverage in percentage points, by kind and by source of the lines."""
    names = [f"{name}{way}" for way in WAYS for name in COVERAGES]
    errors = {name: [e for one in outcomes for e in one.errors.get(name, [])] for name in names}
    return {name: round(float(np.mean(found)), 3) for name, found in errors.items() if found}


def real_flights() -> dict[str, dict[str, int]] | None:
    """Return the anomalies by kind of two real flights without lines, with the shipped weights."""
    folder = os.environ.get("LSNET_PIPE_DATA")
    if folder is None:
        return None
    found = {}
    for name in ("caliterra_foxglove", "brighton_ros2"):
        with tempfile.TemporaryDirectory() as scratch:
            store = Store(Path(scratch))
            put_recording(Path(folder) / "data" / "mcap" / f"{name}.mcap", store)
            index.publish(store)
            rows = select(store, "SELECT kind, count(*) AS n FROM anomalies GROUP BY kind")
        found[name] = {row["kind"]: row["n"] for row in rows}
    return found


def missed_bars(result: dict[str, Any]) -> Iterator[str]:
    """Return the results that miss their bar; anomalies on drawn pictures have none."""
    for kind, scores in result["kinds"].items():
        for name, bar in (("recall", MIN_RECALL), ("precision", MIN_PRECISION)):
            if scores[name] is None or scores[name] < bar:
                yield f"{name} of {kind} is {scores[name]}, not {bar}"
    for way, limit in MAX_ERROR_POINTS.items():
        for name in COVERAGES:
            error = result["coverage_error_points"].get(f"{name}{way}")
            if error is not None and error > limit:
                yield f"error of {name} coverage{way} is {error} points, not {limit}"
    for flight, found in (result["real_flights"] or {}).items():
        if odd := [kind for kind in found if kind in ABOUT_CONDUCTORS]:
            yield f"{flight} has {', '.join(odd)}"
    yield from result["queries"]["missed"]


def parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--drawn", type=int, default=2)
    parser.add_argument("--first-seed", type=int, default=1000)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--kinds", nargs="*", choices=[str(kind) for kind in KINDS], metavar="KIND")
    parser.add_argument("--flights", type=int, default=1000)
    return parser.parse_args()


def main() -> int:
    args = parse_arguments()
    started = time.perf_counter()
    outcomes = run_cases(args)
    result: dict[str, Any] = {
        "kinds": scores_by_kind([one for one in outcomes if not one.case.is_drawn]),
        "kinds_detector": scores_by_kind([one for one in outcomes if one.case.is_drawn]),
        "coverage_error_points": mean_errors(outcomes),
        "clean_flights": sum(one.case.fault is None for one in outcomes),
        "real_flights": real_flights(),
        "queries": measure_queries(args.flights),
    }
    result["missed"] = list(missed_bars(result))
    for group in ("kinds", "kinds_detector"):
        for kind, scores in result[group].items():
            print(f"{group:15} {kind:22} {scores}")
    for miss in result["missed"]:
        print(f"missed: {miss}")
    result["seconds"] = round(time.perf_counter() - started, 1)
    print(json.dumps(result))
    return 1 if result["missed"] else 0


if __name__ == "__main__":
    sys.exit(main())
