"""Conductors in space, from simulated flights whose truth shares no code with what is tested."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import inspected
import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from inspect_pipeline.index import publish as index
from inspect_pipeline.index.reading import select
from inspect_pipeline.inspection.spans import import_spans
from inspect_pipeline.simulation.options import FaultKind, FlightKind, SimulationOptions
from inspect_pipeline.simulation.plan import plan_flight
from inspect_pipeline.simulation.truth import truth_of
from inspect_pipeline.store.store import Store

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = pytest.mark.slow  # a second or so each

ORBIT = SimulationOptions(30.0, 1.0, (1080, 1920), 7, flight=FlightKind.ORBIT)
PASSED = SimulationOptions(40.0, 4.0, (720, 1280), 9800)
NOISY = SimulationOptions(
    24.0, 2.0, (720, 1280), 7, position_noise_m=2.0, drift_m=1.0, attitude_noise_deg=1.0
)

NOISY_ORBIT = replace(ORBIT, seed=9, position_noise_m=2.0, drift_m=1.0, attitude_noise_deg=1.0)


def rows_of(folder: Path, options: SimulationOptions, table: str) -> list[dict[str, Any]]:
    """Rows of a table of the index of a flight with disturbed true lines."""
    store, truth = Store(folder), truth_of(plan_flight(options))
    inspected.write_truth(store, "flight", truth, np.random.default_rng(1))
    import_spans(store, inspected.spans_of(truth))
    index.publish(store)
    return select(store, f"SELECT * FROM {table}")


@pytest.mark.parametrize(
    "options",
    [
        pytest.param(replace(ORBIT, n_circuits=2), id="a pattern that changes with the side"),
        pytest.param(replace(NOISY_ORBIT, n_phases=6), id="frames of which a part is aligned first"),
    ],
)
def test_conductors_seen_from_all_sides_are_where_they_hang(
    tmp_path: Path, options: SimulationOptions
) -> None:
    rows = rows_of(tmp_path, options, "conductors")
    true = np.array([(c.points[0, 1], c.points[:, 2].max()) for c in plan_flight(options).line.conductors])
    first = [row for row in rows if row["span_id"] == rows[0]["span_id"]]
    found = np.array([(row["across_m"], row["raised_m"] + inspected.CONDUCTOR_HEIGHT_M) for row in first])
    apart = np.linalg.norm(true[:, np.newaxis] - true.mean(axis=0) - (found - found.mean(axis=0)), axis=2)
    pairs = linear_sum_assignment(apart)
    assert len(found) == len(true) == 7
    assert apart[pairs].max() < 0.4


def test_conductors_are_told_apart_by_noisy_poses(tmp_path: Path) -> None:
    rows = rows_of(tmp_path, NOISY, "conductors")
    whole = {row["span_id"] for row in rows if row["n_frames"] >= 8}
    assert whole
    for span_id in whole:
        own = [row for row in rows if row["span_id"] == span_id]
        assert len(own) == 4
        assert max(row["sag_m"] for row in own if row["sag_m"] is not None) < 2.0


@pytest.mark.parametrize(("size", "is_judged"), [((2160, 3840), True), ((360, 640), False)])
def test_parallax_shows_whether_one_is_hidden(
    tmp_path: Path, size: tuple[int, int], *, is_judged: bool
) -> None:
    """From one place, only large images show that no conductor hides behind another."""
    options = SimulationOptions(
        20.0, 2.0, size, 9, flight=FlightKind.HOVER, faults=(FaultKind.MISSING_CONDUCTOR,)
    )
    judged = rows_of(tmp_path, options, "span_judged")
    metres = [row["judged_m"] for row in judged if row["kind"] == "conductor_count"]
    assert (max(metres) > 10) == is_judged


def test_a_crossing_line_is_found_at_one_frame_a_second(tmp_path: Path) -> None:
    options = SimulationOptions(30.0, 1.0, (720, 1280), 11, faults=(FaultKind.CROSSING_LINE,))
    (fault,) = truth_of(plan_flight(options)).faults
    crossings = [row for row in rows_of(tmp_path, options, "anomalies") if row["kind"] == "crossing_line"]
    assert [row["span_id"] for row in crossings] == [fault.span_id]


@pytest.mark.parametrize("wind_deg", [0.0, 8.0, 20.0])
def test_uncertainty_of_sags_covers_wind(tmp_path: Path, wind_deg: float) -> None:
    """Seen from one side, conductors that swing aside seem to sag by half a metre more or less."""
    rows = rows_of(tmp_path, replace(PASSED, wind_deg=wind_deg), "conductors")
    off_m = np.array([row["sag_m"] - 1.1 * np.cos(np.radians(wind_deg)) for row in rows if row["sag_m"]])
    sd_m = np.array([row["sag_sd_m"] for row in rows if row["sag_m"]])
    assert len(off_m) >= 10
    assert np.mean(np.abs(off_m) <= 2 * sd_m) >= 0.9
    assert np.median(sd_m) < 0.5


def test_from_all_sides_wind_is_no_sag(tmp_path: Path) -> None:
    rows = rows_of(tmp_path, replace(ORBIT, wind_deg=20.0), "conductors")
    off_m = np.array([row["sag_m"] - 1.1 * np.cos(np.radians(20)) for row in rows if row["sag_m"]])
    assert len(off_m) >= 3
    assert np.median(np.abs(off_m)) < 0.15
    assert np.median([row["sag_sd_m"] for row in rows if row["sag_m"]]) < 0.25
