"""Measure anomalies, conductors and coverage on simulated flights with ground truth, and on real ones.

    python benchmarks/bench_inspection.py [--matrix basic|full] [--short] [--seeds 20] [--clean 60]
        [--drawn 2] [--drawn-clean 2] [--first-seed 1000] [--kinds blur dark ...] [--jobs 2] [--shard 1/4]
        [--results FILE] [--flights 1000]

For each seed and each kind of anomaly, one fault is planted into a flight; --clean flights have none.
`basic`: 40 s at 4 frames a second past a line of three phases, exact poses. `full`: every way to fly, 3 and
6 phases, bundles of 1, 2 and 4, two circuits, 640x360 to 3840x2160, 1 to 10 frames a second and photographs,
hills, corners, wind; half of them with errors of poses. The true lines are disturbed (2 px of noise on every
point, one in ten missed, one false line a frame) and pass through parquet files and the index like all lines.
A hit is an anomaly of the kind whose interval overlaps the true one by at least half of their union; recall
and precision count where the index says that it judged. For --drawn seeds and --drawn-clean flights the
detector is in the loop: flights of 20 s are drawn, in every weather, over photographs without wires too
(where LSNET_PIPE_DATA has them), and processed with the shipped weights.

--short is one seed and three clean flights of the true lines, without queries, in minutes. --results keeps
each outcome and skips those that it has, so a run can be resumed; --shard I/N runs every N-th case.
docs/inspection.md states how long it takes. The exit code is 1 when a bar is missed; the last line is one
JSON object.
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
from inspection_cases import Case, cases_of, put_recording, run_case
from inspection_truth import ABOUT_CONDUCTORS, COVERAGES, KINDS

from inspect_pipeline.config import PlacingOptions
from inspect_pipeline.index import publish as index
from inspect_pipeline.index.reading import select
from inspect_pipeline.simulation.options import FaultKind
from inspect_pipeline.store.store import Store

if TYPE_CHECKING:
    from collections.abc import Iterator

    Results = list[dict[str, Any]]

MIN_RECALL, MIN_PRECISION, MIN_DRAWN_RECALL = 0.90, 0.90, 0.80
MIN_JUDGED = {"1 fps": 0.6, "4 fps": 0.85}  # share of the planted faults, by frames a second
MAX_FALSE_PER_CLEAN = 0.1
MAX_COVERAGE_POINTS, MIN_KNOWN = 2.0, 0.9
MAX_MEDIAN_M = {"height_m": 1.0, "sag_m": 0.5}


def run_cases(cases: list[Case], results: Path | None, jobs: int) -> Results:
    """Return the outcomes of all cases, those in `results` read from there; what is missed is printed."""
    known: dict[str, dict[str, Any]] = {}
    if results and results.exists():
        lines = results.read_text(encoding="utf-8").splitlines()
        known = {one["case"]: one for one in map(json.loads, lines)}
    new = [case for case in cases if case.name not in known]
    with ProcessPoolExecutor(jobs) as pool:
        for one in pool.map(run_case, new):
            known[one["case"]] = one
            if results:
                with results.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(one) + "\n")
            if one["hits"] < one["planted"] or one["others"]:
                judged = "" if all(one["judged"]) else ", not judged"
                print(
                    f"{one['case']}: {one['hits']} of {one['planted']}{judged}, else {one['others']}",
                    flush=True,
                )
    return [known[case.name] for case in cases]


def scores_by_kind(outcomes: Results) -> dict[str, dict[str, Any]]:
    """Recall and precision by kind where it was judged, and the share of the faults that were."""
    clean = [one for one in outcomes if one["fault"] is None]
    in_clean = sum((Counter(one["others"]) for one in clean), Counter[str]())
    kinds = {}
    for fault in dict.fromkeys(one["fault"] for one in outcomes if one["fault"]):
        kind = KINDS[FaultKind(fault)]
        own = [one for one in outcomes if one["fault"] == fault and one["planted"]]
        judged = [one for one in own if one["judged"][0] or one["hits"]]
        hits = sum(one["hits"] for one in judged)
        false = sum(one["others"].get(kind, 0) for one in own) + in_clean[kind]
        elsewhere = sum(one["others"].get(kind, 0) for one in outcomes if one["fault"] not in {fault, None})
        kinds[kind] = {
            "planted": len(own),
            "judged": len(judged),
            "recall": round(hits / len(judged), 3) if judged else None,
            "precision": round(hits / (hits + false), 3) if hits + false else None,
            "false_in_clean": in_clean[kind],
            "false_beside_other_faults": elsewhere,
        }
    return kinds


def summarize(outcomes: Results) -> dict[str, Any]:
    """Return what the bars are about, over outcomes of one way to get lines."""
    clean = [one for one in outcomes if one["fault"] is None]
    conductor_faults = [one for one in outcomes if one["fault"] and KINDS[one["fault"]] in ABOUT_CONDUCTORS]
    judged = {
        rate: [j for one in conductor_faults if one["rate"] == rate for j in one["judged"]]
        for rate in sorted({one["rate"] for one in conductor_faults})
    }
    errors = {name: [e for one in clean for e in one["errors"].get(name, [])] for name in COVERAGES}
    total_m = sum(one["unknown"]["total_m"] for one in clean)
    unknown_m = sum(one["unknown"]["unknown_m"] for one in clean)
    metres = {name: [e for one in outcomes for e in one["conductors"][name]] for name in MAX_MEDIAN_M}
    return {
        "kinds": scores_by_kind(outcomes),
        "judged_share": {rate: round(float(np.mean(own)), 3) for rate, own in judged.items() if own},
        "clean_flights": len(clean),
        "false_per_clean": round(float(np.mean([sum(one["others"].values()) for one in clean])), 3)
        if clean
        else None,
        "coverage_error_points": {n: round(float(np.mean(e)), 2) for n, e in errors.items() if e},
        "known_share": round(1 - unknown_m / total_m, 3) if total_m else None,
        "cpu_s_per_case": round(float(np.mean([one["cpu_s"] for one in outcomes])), 1),
        "unknown_shown_as_zero": sum(one["unknown"]["shown_as_zero"] for one in clean),
        "median_error_m": {n: round(float(np.median(e)), 2) for n, e in metres.items() if e},
    }


def real_flights() -> dict[str, dict[str, int]] | None:
    """Anomalies by kind of two real flights over ground without lines, by the shipped weights."""
    folder = os.environ.get("LSNET_PIPE_DATA")
    if folder is None:
        return None
    found = {}
    for name in ("caliterra_foxglove", "brighton_ros2"):
        with tempfile.TemporaryDirectory() as scratch:
            store = Store(Path(scratch))
            put_recording(Path(folder) / "data" / "mcap" / f"{name}.mcap", store, PlacingOptions())
            index.publish(store)
            rows = select(store, "SELECT kind, count(*) AS n FROM anomalies GROUP BY kind")
        found[name] = {row["kind"]: row["n"] for row in rows}
    return found


def missed_bars(result: dict[str, Any], *, is_drawn: bool) -> Iterator[str]:
    """What of a summary is below a bar."""
    least = {"recall": MIN_DRAWN_RECALL} if is_drawn else {"recall": MIN_RECALL, "precision": MIN_PRECISION}
    for kind, scores in result["kinds"].items():
        for name, bar in least.items():
            if scores[name] is not None and scores[name] < bar:
                yield f"{name} of {kind} is {scores[name]}, not {bar}"
    for rate, share in result["judged_share"].items():
        if share < MIN_JUDGED.get(rate, 0.0):
            yield f"share judged at {rate} is {share}, not {MIN_JUDGED[rate]}"
    most = {
        "false anomalies per clean flight": (result["false_per_clean"], MAX_FALSE_PER_CLEAN),
        "spans unknown and shown as 0": (result["unknown_shown_as_zero"], 0),
        "unknown share of spans": (1 - (result["known_share"] or 1), 1 - MIN_KNOWN),
        **{
            f"{n} coverage error": (e, MAX_COVERAGE_POINTS)
            for n, e in result["coverage_error_points"].items()
        },
        **{f"median error of {n}": (e, MAX_MEDIAN_M[n]) for n, e in result["median_error_m"].items()},
    }
    for name, (value, bar) in most.items():
        if value is not None and value > bar:
            yield f"{name}: {value}, not {bar:g}"


def parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--matrix", choices=("basic", "full"), default="basic")
    parser.add_argument(
        "--short", action="store_true", help="a look of minutes; replaces the next four, and --flights"
    )
    parser.add_argument("--seeds", type=int, default=20, help="of each kind, true lines")
    parser.add_argument("--clean", type=int, default=60, help="flights, true lines")
    parser.add_argument("--drawn", type=int, default=2, help="seeds of each kind, with the detector")
    parser.add_argument("--drawn-clean", type=int, default=2, help="flights, with the detector")
    parser.add_argument("--first-seed", type=int, default=1000)
    parser.add_argument("--kinds", nargs="*", choices=[str(kind) for kind in KINDS], metavar="KIND")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--shard", default="1/1", metavar="I/N")
    parser.add_argument("--results", type=Path, metavar="FILE")
    parser.add_argument("--flights", type=int, default=1000, help="of the index of queries; 0 leaves it out")
    args = parser.parse_args()
    if args.short:
        args.seeds, args.clean, args.drawn, args.drawn_clean, args.flights = 1, 3, 0, 0, 0
    return args


def main() -> int:
    args = parse_arguments()
    started = time.perf_counter()
    kinds = [FaultKind(name) for name in args.kinds] if args.kinds is not None else list(KINDS)
    first, step = map(int, args.shard.split("/"))
    cases = [
        case
        for is_drawn, counts in ((True, (args.drawn_clean, args.drawn)), (False, (args.clean, args.seeds)))
        for case in cases_of(args.matrix, kinds, args.first_seed, counts, is_drawn=is_drawn)
    ]
    outcomes = run_cases(cases[first - 1 :: step], args.results, args.jobs)
    result: dict[str, Any] = {"matrix": args.matrix, "missed": []}
    for name, is_drawn in (("true lines", False), ("detector", True)):
        own = [one for one in outcomes if one["is_drawn"] == is_drawn]
        if not own:
            continue
        result[name] = summarize(own)
        result["missed"] += [f"{name}: {miss}" for miss in missed_bars(result[name], is_drawn=is_drawn)]
        for kind, scores in result[name]["kinds"].items():
            print(f"{name:10} {kind:22} {scores}")
        for row in list(result[name])[1:]:
            print(f"{name:10} {row:22} {result[name][row]}")
    if args.flights:
        result["queries"] = measure_queries(args.flights)
        result["missed"] += result["queries"]["missed"]
        result["real_flights"] = real_flights()
        for flight, found in (result["real_flights"] or {}).items():
            odd = [kind for kind in found if kind in ABOUT_CONDUCTORS]
            result["missed"] += [f"{flight} has {', '.join(odd)}"] if odd else []
    for miss in result["missed"]:
        print(f"missed: {miss}")
    result["seconds"] = round(time.perf_counter() - started, 1)
    print(json.dumps(result))
    return 1 if result["missed"] else 0


if __name__ == "__main__":
    sys.exit(main())
