"""Simulated flights put into a store: as lines that are the truth, disturbed or not, or as drawn pictures.

Cases of the matrix `basic` pass by a line of three phases with exact poses; those of `full` are sampled
evenly from every way to fly, kind of line, size of images, rate of frames and error of poses.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import cv2
import numpy as np
from inspection_truth import (
    ABOUT_CONDUCTORS,
    KINDS,
    conductor_errors,
    coverage_errors,
    is_judged,
    match,
    true_coverage,
    unknown_coverage,
)

from inspect_pipeline.config import ProcessOptions, start_run
from inspect_pipeline.index import publish as index
from inspect_pipeline.index.reading import select
from inspect_pipeline.inspection.spans import import_spans
from inspect_pipeline.pipeline import process
from inspect_pipeline.simulation.options import FaultKind, FlightKind, SimulationOptions
from inspect_pipeline.simulation.plan import plan_flight
from inspect_pipeline.simulation.truth import truth_of
from inspect_pipeline.simulation.write import simulate_flight
from inspect_pipeline.store.store import Store
from lsnet import Detector

sys.path.append(str(Path(__file__).parents[1] / "tests" / "helpers"))
import inspected  # after lsnet, of which the tests have a folder too

if TYPE_CHECKING:
    from collections.abc import Iterator

    from inspect_pipeline.simulation.records import FlightTruth

_TRUE_S, _DRAWN_S = 40.0, 20.0
_SIZES = ((360, 640), (720, 1280), (1080, 1920), (2160, 3840))
_LINES = ((3, 1, 1), (6, 1, 1), (3, 2, 1), (3, 4, 1), (3, 1, 2))  # phases, bundle, circuits
_RATES = (1.0, 2.0, 4.0, 10.0)
_QUERIES = {
    "anomalies": "SELECT kind, start_ns, end_ns, span_id FROM anomalies ORDER BY ALL",
    "coverage": "SELECT kind, unit, span_id, share, total, unknown, covered FROM coverage"
    " WHERE channel_id IS NULL",
    "judged": "SELECT span_id, kind, judged_m, length_m FROM span_judged",
    "conductors": "SELECT * FROM conductors",
}

Matrix = Literal["basic", "full"]


@dataclass(frozen=True)
class Case:
    """A flight to simulate, and whether it is drawn for the detector."""

    options: SimulationOptions
    is_drawn: bool

    @property
    def fault(self) -> FaultKind | None:
        return self.options.faults[0] if self.options.faults else None

    @property
    def name(self) -> str:
        one = self.options
        noise = f" noise {one.position_noise_m:.1f} m" if one.position_noise_m else ""
        how = "drawn " if self.is_drawn else ""
        return (
            f"{how}seed {one.seed} {self.fault or 'clean'} {one.flight} {one.fps:g} fps"
            f" {one.image_size[1]} px {one.n_phases}x{one.n_bundle}x{one.n_circuits}{noise}"
        )


def cases_of(
    matrix: Matrix, kinds: list[FaultKind], seeds: range, n_drawn: int, n_clean: int
) -> Iterator[Case]:
    """Yield the cases of a matrix: of each kind one a seed, and clean flights; first those that are drawn."""
    for is_drawn, own in ((True, seeds[:n_drawn]), (False, seeds)):
        if not own:
            continue
        clean = range(own.start + 500, own.start + 500 + (n_drawn if is_drawn else n_clean))
        for fault, number, seed in [
            *((None, i, seed) for i, seed in enumerate(clean)),
            *((kind, i, seed) for kind in kinds for i, seed in enumerate(own)),
        ]:
            yield Case(_options(matrix, fault, number, seed, is_drawn=is_drawn), is_drawn)


def _options(
    matrix: Matrix, fault: FaultKind | None, number: int, seed: int, *, is_drawn: bool
) -> SimulationOptions:
    seconds, size = (_DRAWN_S, _SIZES[0]) if is_drawn else (_TRUE_S, _SIZES[1])
    options = SimulationOptions(seconds, 4.0, size, seed, faults=() if fault is None else (fault,))
    flown = list(FlightKind)
    if matrix == "basic":
        return options if fault else replace(options, flight=flown[number % len(flown)])
    # Each property by a permutation of its own, so that all values come up evenly and independently.
    rng = np.random.default_rng([seed, 7, list(KINDS).index(fault) if fault else 99])
    phases, bundle, circuits = _LINES[rng.integers(len(_LINES))]
    is_noisy = bool(rng.integers(2))
    return replace(
        options,
        fps=4.0 if is_drawn else _RATES[(number + rng.integers(2) * 2) % len(_RATES)],
        image_size=_SIZES[rng.integers(2 if is_drawn else len(_SIZES))],
        flight=flown[rng.integers(len(flown))],
        n_phases=phases,
        n_bundle=bundle,
        n_circuits=circuits,
        position_noise_m=float(rng.uniform(1, 3)) if is_noisy else 0.0,
        drift_m=float(rng.uniform(0, 2)) if is_noisy else 0.0,
        attitude_noise_deg=1.0 if is_noisy else 0.0,
    )


def run_case(case: Case) -> dict[str, Any]:
    """Simulate a flight, index it, and compare what the index says with the truth, as JSON values."""
    cv2.setNumThreads(1)  # cases run beside each other
    plan = plan_flight(case.options)
    truth = truth_of(plan)
    rng = np.random.default_rng(case.options.seed)
    with tempfile.TemporaryDirectory() as folder:
        store = Store(Path(folder))
        if case.is_drawn:
            _put_pictures(store, case.options)
        else:
            inspected.write_truth(store, "flight", truth, rng)
        rows = _inspect(store, truth)
    hits, others = match(truth, rows["anomalies"])
    result: dict[str, Any] = {
        "case": case.name,
        "fault": case.fault,
        "fps": case.options.fps,
        "is_drawn": case.is_drawn,
        "planted": len(truth.faults),
        "hits": hits,
        "others": dict(others),
        "judged": [is_judged(plan, truth, fault, rows) for fault in truth.faults],
        "conductors": conductor_errors(plan, rows["conductors"]),
    }
    if case.fault is None:
        wanted = true_coverage(plan, truth)
        result["errors"] = coverage_errors(rows["coverage"], wanted)
        result["unknown"] = asdict(unknown_coverage(rows["coverage"]))
    result["about_conductors"] = sum(n for kind, n in others.items() if kind in ABOUT_CONDUCTORS)
    return result


def _put_pictures(store: Store, options: SimulationOptions) -> None:
    """Draw a recording and process it."""
    with tempfile.TemporaryDirectory() as folder:
        recording = Path(folder) / "flight.mcap"
        simulate_flight(recording, options)
        put_recording(recording, store)


def put_recording(recording: Path, store: Store) -> None:
    """Process a recording by the shipped weights."""
    detector, options = _detector(), ProcessOptions(write="none")
    process(recording, store, detector, options, start_run(detector, options))


@cache
def _detector() -> Detector:
    return Detector.load()


def _inspect(store: Store, truth: FlightTruth) -> dict[str, Any]:
    """The rows that the index has of a flight, its spans known."""
    import_spans(store, inspected.spans_of(truth))
    index.publish(store)
    return {name: select(store, sql) for name, sql in _QUERIES.items()}
