"""The spans of a simulated line, as `spans import` reads them."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from inspect_pipeline.inspection.span_files import read_spans
from inspect_pipeline.simulation.options import SimulationOptions
from inspect_pipeline.simulation.span_file import write_spans
from inspect_pipeline.simulation.truth import simulate_truth

if TYPE_CHECKING:
    from pathlib import Path


def test_the_spans_are_those_of_the_truth(tmp_path: Path) -> None:
    truth = simulate_truth(SimulationOptions(seconds=10))
    fields = {
        "structures": [
            {"structure_id": one.structure_id, "lat_deg": one.lat_deg, "lon_deg": one.lon_deg}
            for one in truth.structures
        ],
        "spans": [
            {"span_id": one.span_id, "structure_ids": one.structure_ids, "expected_conductors": 4}
            for one in truth.spans
        ],
    }
    (tmp_path / "a.truth.json").write_text(json.dumps(fields))
    write_spans(tmp_path / "a.geojson", tmp_path / "a.truth.json")
    spans = read_spans(tmp_path / "a.geojson")
    assert [one.span_id for one in spans] == [one.span_id for one in truth.spans]
    assert all(abs(one.length_m - true.length_m) < 0.01 for one, true in zip(spans, truth.spans, strict=True))
    assert {one.expected_conductors for one in spans} == {4}
