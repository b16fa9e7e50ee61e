"""Simulated flights put into a store: as lines that are the truth, disturbed or not, or as drawn pictures.

Cases of the matrix `basic` pass by a line of three phases with exact poses; those of `full` are sampled
evenly from every way to fly, kind of line, route, size of images, rate of frames or photographs, error of
poses, and wind; drawn ones also from every weather, ground and kind of tower.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

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

from inspect_pipeline.config import PlacingOptions, ProcessOptions, start_run
from inspect_pipeline.convert.photographs import pack_photographs
from inspect_pipeline.index import publish as index
from inspect_pipeline.index.reading import select
from inspect_pipeline.inspection.spans import import_spans
from inspect_pipeline.pipeline import process
from inspect_pipeline.simulation.options import (
    LINE_FAULTS,
    FaultKind,
    FlightKind,
    SchemaKind,
    SimulationOptions,
    TowerKind,
    WeatherKind,
)
from inspect_pipeline.simulation.plan import plan_flight
from inspect_pipeline.simulation.terrain_file import write_terrain
from inspect_pipeline.simulation.truth import truth_of
from inspect_pipeline.simulation.write import simulate_flight
from inspect_pipeline.store.store import Store
from lsnet import Detector

sys.path.append(str(Path(__file__).parents[1] / "tests" / "helpers"))
import inspected  # after lsnet, of which the tests have a folder too

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from inspect_pipeline.simulation.records import FlightTruth

_TRUE_S, _DRAWN_S = 40.0, 20.0
_SIZES = ((360, 640), (720, 1280), (1080, 1920), (2160, 3840))
_LINES = ((3, 1, 1), (6, 1, 1), (3, 2, 1), (3, 4, 1), (3, 1, 2))  # phases, bundle, circuits
_RATES = tuple((fps, SchemaKind.FOXGLOVE) for fps in (1.0, 2.0, 4.0, 10.0))
_PHOTOGRAPHS = (1.0, SchemaKind.PHOTOGRAPHS)
_ROUTES = ((0.0, 0.0), (5.0, 0.0), (0.0, 30.0), (5.0, -30.0))  # hills in m, corner in degrees
_WINDS_DEG = (0.0, 8.0)
_QUERIES = {
    "anomalies": "SELECT kind, start_ns, end_ns, span_id FROM anomalies ORDER BY ALL",
    "coverage": "SELECT kind, unit, span_id, share, total, unknown, covered FROM coverage"
    " WHERE channel_id IS NULL",
    "judged": "SELECT span_id, kind, judged_m, length_m FROM span_judged",
    "conductors": "SELECT * FROM conductors",
}

Matrix = Literal["basic", "full"]
T = TypeVar("T")


@dataclass(frozen=True)
class Case:
    """A flight to simulate, and whether it is drawn for the detector."""

    options: SimulationOptions
    is_drawn: bool

    @property
    def fault(self) -> FaultKind | None:
        return self.options.faults[0] if self.options.faults else None

    @property
    def rate(self) -> str:
        is_still = self.options.schema == SchemaKind.PHOTOGRAPHS
        return "photographs" if is_still else f"{self.options.fps:g} fps"

    @property
    def name(self) -> str:
        one = self.options
        words = [
            *(["drawn"] if self.is_drawn else []),
            f"seed {one.seed} {self.fault or 'clean'} {one.flight} {self.rate} {one.image_size[1]} px",
            f"{one.n_phases}x{one.n_bundle}x{one.n_circuits}",
            *([f"noise {one.position_noise_m:.1f} m"] if one.position_noise_m else []),
            *([f"hills {one.hills_m:g} m"] if one.hills_m else []),
            *([f"corner {one.corner_deg:g}"] if one.corner_deg else []),
            *([f"wind {one.wind_deg:g}"] if one.wind_deg else []),
        ]
        if self.is_drawn:
            words += [one.weather, one.towers, "photograph" if one.ground else "meadow"]
        return " ".join(words)


def cases_of(
    matrix: Matrix, kinds: list[FaultKind], first_seed: int, counts: tuple[int, int], *, is_drawn: bool
) -> Iterator[Case]:
    """Yield clean flights and those of each kind; `counts` has how many of the clean ones and of a kind."""
    n_clean, n_seeds = counts
    for seed in range(first_seed + 500, first_seed + 500 + n_clean):
        yield Case(_options(matrix, None, seed, is_drawn=is_drawn), is_drawn)
    for kind in kinds:
        for seed in range(first_seed, first_seed + n_seeds):
            yield Case(_options(matrix, kind, seed, is_drawn=is_drawn), is_drawn)


def _options(matrix: Matrix, fault: FaultKind | None, seed: int, *, is_drawn: bool) -> SimulationOptions:
    seconds, size = (_DRAWN_S, _SIZES[0]) if is_drawn else (_TRUE_S, _SIZES[1])
    options = SimulationOptions(seconds, 4.0, size, seed, faults=() if fault is None else (fault,))
    flown = list(FlightKind)
    if matrix == "basic":
        return options if fault else replace(options, flight=flown[seed % len(flown)])
    draw = _Draw(seed, list(KINDS).index(fault) if fault else len(KINDS))
    phases, bundle, circuits = draw.one_of(_LINES)
    # A drawn flight takes long, and a photograph shows neither pauses nor what messages say.
    rates = (_RATES[0], _RATES[2]) if is_drawn else _RATES
    fps, schema = draw.one_of((*rates, _PHOTOGRAPHS) if fault is None or fault in LINE_FAULTS else rates)
    hills_m, corner_deg = draw.one_of(_ROUTES)
    is_noisy = draw.one_of((False, True))
    rng = np.random.default_rng([seed, 7])
    options = replace(
        options,
        fps=fps,
        schema=schema,
        image_size=draw.one_of(_SIZES[:3] if is_drawn else _SIZES),
        flight=draw.one_of(flown),
        n_phases=phases,
        n_bundle=bundle,
        n_circuits=circuits,
        position_noise_m=float(rng.uniform(1, 3)) if is_noisy else 0.0,
        drift_m=float(rng.uniform(0, 2)) if is_noisy else 0.0,
        attitude_noise_deg=1.0 if is_noisy else 0.0,
        hills_m=hills_m,
        corner_deg=corner_deg,
        wind_deg=draw.one_of(_WINDS_DEG),
    )
    if not is_drawn:
        return options
    return replace(
        options,
        weather=draw.one_of(tuple(WeatherKind)),
        towers=draw.one_of(tuple(TowerKind)),
        ground=draw.one_of((None, draw.one_of(_grounds()))),
    )


class _Draw:
    """Draws values by the seed: of as many seeds in a row as there are values, each has another one.

    The order of the values is another one for each property, each run of seeds and each series of cases.
    """

    def __init__(self, seed: int, series: int) -> None:
        self._seed, self._series, self._n_drawn = seed, series, 0

    def one_of(self, values: Sequence[T]) -> T:
        self._n_drawn += 1
        run, number = divmod(self._seed, len(values))
        order = np.random.default_rng([self._series, self._n_drawn, run]).permutation(len(values))
        return values[order[number]]


@cache
def _grounds() -> tuple[Path | None, ...]:
    """Photographs from above without wires, where the data is; else none."""
    folder = os.environ.get("LSNET_PIPE_DATA")
    found = sorted(Path(folder, "data", "no_wires").glob("*/*.jpg")) if folder else []
    return tuple(found) or (None,)


def run_case(case: Case) -> dict[str, Any]:
    """Simulate a flight, index it, and compare what the index says with the truth, as JSON values."""
    cv2.setNumThreads(1)  # cases run beside each other
    started_s = time.process_time()
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
        "rate": case.rate,
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
    result["cpu_s"] = round(time.process_time() - started_s, 2)
    result["about_conductors"] = sum(n for kind, n in others.items() if kind in ABOUT_CONDUCTORS)
    return result


def _put_pictures(store: Store, options: SimulationOptions) -> None:
    """Draw a recording and process it."""
    with tempfile.TemporaryDirectory() as folder:
        recording, terrain = Path(folder) / "flight.mcap", Path(folder) / "terrain.asc"
        if options.schema == SchemaKind.PHOTOGRAPHS:
            simulate_flight(Path(folder) / "photographs", options)
            pack_photographs(Path(folder) / "photographs", recording)
        else:
            simulate_flight(recording, options)
        if options.hills_m:
            write_terrain(terrain, options)
        put_recording(recording, store, PlacingOptions(terrain=terrain if options.hills_m else None))


def put_recording(recording: Path, store: Store, placing: PlacingOptions) -> None:
    """Process a recording by the shipped weights."""
    detector, options = _detector(), ProcessOptions(write="none", placing=placing)
    process(recording, store, detector, options, start_run(detector, options))


@cache
def _detector() -> Detector:
    return Detector.load()


def _inspect(store: Store, truth: FlightTruth) -> dict[str, Any]:
    """The rows that the index has of a flight, its spans known."""
    import_spans(store, inspected.spans_of(truth))
    index.publish(store)
    return {name: select(store, sql) for name, sql in _QUERIES.items()}
