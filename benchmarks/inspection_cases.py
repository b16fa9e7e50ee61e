"""Put simulated flights into a store: as true lines, disturbed or not, or as drawn images."""

from __future__ import annotations

import sys
import tempfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from inspection_truth import coverage_errors, match, true_coverage

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
    from collections import Counter

    from inspect_pipeline.simulation.records import FlightTruth

_FPS = 4.0
_TRUE_S, _DRAWN_S = 40.0, 20.0
_TRUE_SIZE, _DRAWN_SIZE = (720, 1280), (360, 640)  # height, width


@dataclass(frozen=True)
class Case:
    """A flight to simulate: its fault, or none, and kind of flight; drawn for the detector, or not."""

    seed: int
    fault: FaultKind | None
    flight: FlightKind = FlightKind.PASS_BY
    is_drawn: bool = False

    @property
    def options(self) -> SimulationOptions:
        faults = () if self.fault is None else (self.fault,)
        seconds, size = (_DRAWN_S, _DRAWN_SIZE) if self.is_drawn else (_TRUE_S, _TRUE_SIZE)
        return SimulationOptions(seconds, _FPS, size, self.seed, self.flight, faults=faults)

    def __str__(self) -> str:
        how = ", drawn" if self.is_drawn else ""
        return f"seed {self.seed} {self.fault or f'clean, {self.flight}'}{how}"


@dataclass(frozen=True)
class Outcome:
    """Results: hits of the planted kind, other findings by kind, errors of coverage in points."""

    case: Case
    n_planted: int
    n_hits: int
    others: Counter[str]
    errors: dict[str, list[float]]


def run_case(case: Case) -> Outcome:
    """Simulate a flight, put it into a store, and compare the index with the ground truth."""
    cv2.setNumThreads(1)  # cases run beside each other
    plan = plan_flight(case.options)
    truth = truth_of(plan)
    rng = np.random.default_rng(case.seed)
    with tempfile.TemporaryDirectory() as folder:
        way = "detector" if case.is_drawn else "disturbed"
        store = Store(Path(folder) / way)
        if case.is_drawn:
            _put_pictures(store, case.options)
        else:
            inspected.write_truth(store, "flight", truth, rng)
        rows = _inspect(store, truth)
        errors = {}
        if case.fault is None:
            wanted = true_coverage(plan, truth)
            errors = {f"{name} {way}": e for name, e in coverage_errors(rows["coverage"], wanted).items()}
            if not case.is_drawn:
                true = Store(Path(folder) / "true")
                inspected.write_truth(true, "flight", truth, None)
                errors |= coverage_errors(_inspect(true, truth)["coverage"], wanted)
    hits, others = match(truth, rows["anomalies"])
    return Outcome(case, len(truth.faults), hits, others, errors)


def _put_pictures(store: Store, options: SimulationOptions) -> None:
    """Draw a recording and process it."""
    with tempfile.TemporaryDirectory() as folder:
        recording = Path(folder) / "flight.mcap"
        simulate_flight(recording, options)
        put_recording(recording, store)


def put_recording(recording: Path, store: Store) -> None:
    """Process a recording with the shipped weights."""
    detector, options = _detector(), ProcessOptions(write="none")
    process(recording, store, detector, options, start_run(detector, options))


@cache
def _detector() -> Detector:
    return Detector.load()


def _inspect(store: Store, truth: FlightTruth) -> dict[str, Any]:
    """Return the rows of anomalies and coverage of a flight, after importing its spans."""
    import_spans(store, inspected.spans_of(truth))
    index.publish(store)
    anomalies = select(store, "SELECT kind, start_ns, end_ns FROM anomalies ORDER BY ALL")
    coverage = select(store, "SELECT kind, unit, span_id, share FROM coverage WHERE channel_id IS NULL")
    return {"anomalies": anomalies, "coverage": coverage}
