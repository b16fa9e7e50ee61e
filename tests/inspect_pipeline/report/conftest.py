"""A published store of two flights, one with faults, the other with a hostile name."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING

import flights as made
import inspected
import pytest
from pages import HOSTILE

from inspect_pipeline.inspection.spans import import_spans
from inspect_pipeline.publishing import publish
from inspect_pipeline.simulation.options import FaultKind, SimulationOptions
from inspect_pipeline.simulation.truth import simulate_truth
from inspect_pipeline.store.store import Store

if TYPE_CHECKING:
    from pathlib import Path

    from inspect_pipeline.simulation.records import FlightTruth


@pytest.fixture(scope="session")
def truth() -> FlightTruth:
    faults = (FaultKind.CONDUCTOR_GAP, FaultKind.DARK)
    return simulate_truth(SimulationOptions(20, 2, seed=3, faults=faults))


@pytest.fixture(scope="session")
def template(tmp_path_factory: pytest.TempPathFactory, truth: FlightTruth) -> Store:
    """Is only read."""
    store = Store(tmp_path_factory.mktemp("report"))
    inspected.write_truth(store, "faulty", truth)
    made.write_flight(store, HOSTILE)
    import_spans(store, inspected.spans_of(truth))
    publish(store)
    return store


@pytest.fixture
def store(template: Store, tmp_path: Path) -> Store:
    """A copy of it."""
    return Store(shutil.copytree(template.root, tmp_path / "store"))
