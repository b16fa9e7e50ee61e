"""Two flights over one line, the second with a fault: what `compare` and the named query report."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import inspected
from typer.testing import CliRunner

import cli
from inspect_pipeline.index import publish as index
from inspect_pipeline.index.named_queries import find_query
from inspect_pipeline.index.reading import select
from inspect_pipeline.inspection.spans import import_spans
from inspect_pipeline.simulation.options import FaultKind, SimulationOptions
from inspect_pipeline.simulation.truth import simulate_truth
from inspect_pipeline.store.store import Store

if TYPE_CHECKING:
    from pathlib import Path

    import pytest


def test_a_conductor_that_is_missing_since_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = Store(tmp_path / "inspections")
    monkeypatch.setenv("LSNET_PIPE_STORE", str(store.root))
    whole, faulty = (
        simulate_truth(SimulationOptions(22, 2, seed=11, faults=faults))
        for faults in ((), (FaultKind.MISSING_CONDUCTOR,))
    )
    before, after = (
        inspected.write_truth(store, name, truth) for name, truth in (("before", whole), ("after", faulty))
    )
    import_spans(store, inspected.spans_of(whole))
    index.publish(store)
    (fault,) = faulty.faults
    done = CliRunner().invoke(cli.app, ["compare", before[:8], after[:8], "--json"])
    assert done.exit_code == 0
    assert "judged by both flights" in done.stderr
    changes = [json.loads(line) for line in done.stdout.splitlines()]
    counts = [(c["span_id"], c["before"], c["after"]) for c in changes if c["subject"] == "conductors"]
    assert counts == [(fault.span_id, 4, 3)]
    assert {c["span_id"] for c in changes} == {fault.span_id}
    assert CliRunner().invoke(cli.app, ["compare", before[:8], before[:8]]).stdout == "no change\n"
    assert not select(store, find_query("changes").with_values({"flight": before}))


def test_heights_and_sags_are_those_of_the_simulator(tmp_path: Path) -> None:
    """Phases hang 0.6 and 1.2 m above the height in the spans file, the neutral 2.5 m below; sag 1.1 m."""
    store = Store(tmp_path)
    truth = simulate_truth(SimulationOptions(22, 2, seed=11))
    inspected.write_truth(store, "flight", truth)
    import_spans(store, inspected.spans_of(truth))
    index.publish(store)
    rows = select(store, "SELECT * FROM conductors WHERE sag_m IS NOT NULL")
    assert len(rows) >= 4
    assert {row["conductor"] for row in rows} == {1, 2, 3, 4}
    for row in rows:
        assert abs(row["sag_m"] - 1.1) < 4 * row["sag_sd_m"]
    lowest = min(rows, key=lambda row: row["raised_m"])
    assert abs(lowest["raised_m"] + 2.5) < 4 * lowest["raised_sd_m"]
    assert abs(lowest["ground_m"] - (9.2 - 1.1)) < 4 * lowest["ground_sd_m"]
