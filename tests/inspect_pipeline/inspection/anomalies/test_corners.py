"""Lines that bend: conductors beyond a corner cross nothing. By simulated flights and their truth."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import inspected
import numpy as np
import pytest

from inspect_pipeline.index import publish as index
from inspect_pipeline.index.reading import select
from inspect_pipeline.inspection.spans import import_spans
from inspect_pipeline.simulation.options import FaultKind, SimulationOptions
from inspect_pipeline.simulation.truth import simulate_truth
from inspect_pipeline.store.store import Store

if TYPE_CHECKING:
    from pathlib import Path

    from inspect_pipeline.simulation.records import FlightTruth

pytestmark = pytest.mark.slow  # seconds each

CORNER = SimulationOptions(40.0, 4.0, (720, 1280), 9800, corner_deg=30.0)


def anomalies(folder: Path, truth: FlightTruth, first: int, stop: int) -> list[tuple[str, str]]:
    """Kinds and spans of the anomalies of a flight of which some spans are imported."""
    store = Store(folder)
    inspected.write_truth(store, "flight", truth, np.random.default_rng(1))
    import_spans(store, inspected.spans_of(truth)[first:stop])
    index.publish(store)
    rows = select(store, "SELECT kind, span_id FROM anomalies ORDER BY start_ns")
    return [(row["kind"], row["span_id"]) for row in rows]


def corner_of(truth: FlightTruth) -> int:
    """The number of the first span after the corner."""
    places = np.array([(one.lat_deg, one.lon_deg) for one in truth.structures])
    steps = np.diff(places, axis=0) * (1.0, np.cos(np.radians(places[0, 0])))
    directions = np.arctan2(steps[:, 0], steps[:, 1])
    return int(np.argmax(np.abs(np.angle(np.exp(1j * np.diff(directions)))))) + 1


@pytest.mark.parametrize("corner_deg", [30.0, -30.0])
def test_conductors_beyond_a_corner_cross_nothing(tmp_path: Path, corner_deg: float) -> None:
    """Whether the spans beyond it are imported or not."""
    truth = simulate_truth(replace(CORNER, corner_deg=corner_deg))
    corner = corner_of(truth)
    for name, first, stop in (("all", 0, 99), ("before", 0, corner)):
        assert anomalies(tmp_path / name, truth, first, stop) == []


@pytest.mark.parametrize("seed", [9800, 9801])
def test_a_line_that_crosses_beside_a_corner_is_found(tmp_path: Path, seed: int) -> None:
    truth = simulate_truth(replace(CORNER, seed=seed, faults=(FaultKind.CROSSING_LINE,)))
    (fault,) = truth.faults
    corner, crossed = corner_of(truth), [one.span_id for one in truth.spans].index(fault.span_id)
    assert crossed in {corner - 1, corner}
    alone = (0, corner) if crossed < corner else (corner, 99)
    for name, first, stop in (("all", 0, 99), ("alone", *alone)):
        assert anomalies(tmp_path / name, truth, first, stop) == [("crossing_line", fault.span_id)]
