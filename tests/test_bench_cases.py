"""The cases of `make bench-inspection`: the hard matrix has every property, each of its values as often."""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

sys.path.append(str(Path(__file__).parents[1] / "benchmarks"))
from inspection_cases import cases_of
from inspection_truth import conductor_errors

from inspect_pipeline.simulation.options import FRAME_FAULTS, FaultKind, SchemaKind, SimulationOptions
from inspect_pipeline.simulation.plan import plan_flight

if TYPE_CHECKING:
    from inspection_cases import Case

VALUES = {
    "flight": 4,
    "image_size": 4,
    "hills_m": 2,
    "corner_deg": 3,
    "wind_deg": 2,
    "n_phases": 2,
    "n_bundle": 3,
    "n_circuits": 2,
    "attitude_noise_deg": 2,
}
LOOKS = {"weather": 3, "towers": 2}


def full(*, is_drawn: bool) -> list[Case]:
    return list(cases_of("full", list(FaultKind), 1000, (60, 20), is_drawn=is_drawn))


def test_the_hard_matrix_has_twenty_cases_of_each_kind_and_sixty_clean_flights() -> None:
    cases = full(is_drawn=False)
    assert Counter(case.fault for case in cases) == {None: 60, **dict.fromkeys(FaultKind, 20)}
    assert len({case.name for case in cases}) == len(cases)  # by which a run is resumed
    assert not set(cases) & set(cases_of("full", list(FaultKind), 2000, (60, 20), is_drawn=False))


@pytest.mark.parametrize("is_drawn", [False, True])
def test_the_values_of_each_property_come_up_evenly(monkeypatch: pytest.MonkeyPatch, is_drawn: bool) -> None:
    monkeypatch.delenv("LSNET_PIPE_DATA", raising=False)
    for kind in FaultKind:
        own = [case.options for case in full(is_drawn=is_drawn) if case.fault == kind]
        for name, n_values in (VALUES | {"image_size": 3} | LOOKS if is_drawn else VALUES).items():
            counts = Counter(getattr(one, name) for one in own)
            assert len(counts) == n_values, name
            if name not in {"n_phases", "n_bundle", "n_circuits", "corner_deg"}:  # which come together
                assert max(counts.values()) - min(counts.values()) <= 2, name
        n_photographs = sum(one.schema == SchemaKind.PHOTOGRAPHS for one in own)
        assert (n_photographs == 0) == (kind in FRAME_FAULTS)
    pairs = Counter((case.options.flight, case.options.fps) for case in full(is_drawn=is_drawn))
    assert min(pairs.values()) >= 2  # no property goes with another


def test_conductors_are_told_where_only_some_have_a_row() -> None:
    """Those of one circuit of two, a metre beside where they hang: their heights are those of the truth."""
    plan = plan_flight(SimulationOptions(20.0, 1.0, (360, 640), 5, n_circuits=2))
    across_m, sag_m = 3.0, 55.0 * 0.02
    rows = [
        {"span_id": plan.span_id(2), "across_m": across_m + 1.0, "raised_m": height_m - 11.7, "sag_m": sag_m}
        for height_m in (15.0, 12.8, 10.6)
    ]
    errors = conductor_errors(plan, rows)
    assert errors["height_m"] == pytest.approx([0.0, 0.0, 0.0], abs=0.01)
