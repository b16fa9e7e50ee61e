"""A flight of 5 km: the local frame of its first position holds to its end."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import inspected
import numpy as np
import pytest

from inspect_pipeline.index.publish import publish
from inspect_pipeline.index.reading import select
from inspect_pipeline.inspection.spans import import_spans
from inspect_pipeline.simulation.options import SimulationOptions
from inspect_pipeline.simulation.truth import simulate_truth
from inspect_pipeline.store.store import Store

if TYPE_CHECKING:
    from pathlib import Path


def test_spans_are_covered_as_the_truth_says_five_kilometres_from_the_start(tmp_path: Path) -> None:
    """Within the bar of docs/inspection.md: a mean error of one percentage point."""
    truth = simulate_truth(SimulationOptions(seconds=1000, fps=0.5, seed=3))
    first, skipped, last = truth.frames[:3], truth.frames[3:-150], truth.frames[-150:]
    store = Store(tmp_path)
    inspected.write_truth(store, "flight", replace(truth, frames=[*first, *last]))
    import_spans(store, inspected.spans_of(truth))
    publish(store)
    nearer = {view.span_id for frame in (*first, *skipped) for view in frame.views}
    found = select(store, "SELECT span_id, share, total FROM coverage WHERE kind = 'span'")
    rows = [row for row in found if row["span_id"] not in nearer]
    errors = [abs(row["share"] - truth.span_coverage[row["span_id"]]) for row in rows]
    assert len(rows) > 25
    assert 100 * np.mean(errors) < 1.0
    assert [row["total"] for row in rows] == pytest.approx([55.0] * len(rows), abs=1e-3)
