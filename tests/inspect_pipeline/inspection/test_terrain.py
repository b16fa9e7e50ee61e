"""The ground along a flight: by hand-made slopes, and by simulated flights over hills with their truth."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import inspected
import numpy as np
import pytest
from inspect_rows import ORIGIN, flight

from inspect_pipeline.index import publish as index
from inspect_pipeline.index.reading import select
from inspect_pipeline.inspection.spans import import_spans
from inspect_pipeline.inspection.terrain import LEVEL, Ground, find_ground
from inspect_pipeline.simulation.options import FaultKind, FlightKind, SimulationOptions
from inspect_pipeline.simulation.plan import plan_flight
from inspect_pipeline.simulation.truth import truth_of
from inspect_pipeline.store.store import Store

if TYPE_CHECKING:
    from pathlib import Path

    from inspect_pipeline.simulation.plan import FlightPlan

HILLS = SimulationOptions(40.0, 2.0, (720, 1280), 9800, hills_m=10.0)


def test_a_slope_is_known_beyond_and_between_its_samples() -> None:
    places = np.stack(np.meshgrid(np.arange(0.0, 60, 5), np.arange(0.0, 60, 5)), axis=-1).reshape(-1, 2)
    slope = Ground(places, 3 + places @ (0.1, -0.05))
    asked = np.array([[22.0, 31.0], [57.0, 2.0], [70.0, 30.0]])
    assert slope.at(asked) == pytest.approx(3 + asked @ (0.1, -0.05), abs=0.15)
    assert np.abs(LEVEL.at(asked)).max() == 0
    assert slope.is_known(asked)
    assert not slope.is_known(np.array([[90.0, 30.0]]))
    one = Ground(np.array([[5.0, 5.0]]), np.array([7.0]))
    assert one.at(asked) == pytest.approx(7)  # which says nothing of slopes


def test_frames_know_the_ground_below_and_ahead() -> None:
    """Frames 30 m above ground that rises by a tenth to the east look 40 m ahead: 4 m up."""
    camera = flight(np.arange(0.0, 100, 10), np.ones(10, bool), 30.0)
    along_m = np.arange(0.0, 100, 10)
    ahead = ORIGIN.to_degrees(np.column_stack((along_m + 40, np.zeros(10))))
    frames = replace(
        camera.frames,
        rise_m=0.1 * along_m,
        ground_lat_deg=ahead[0],
        ground_lon_deg=ahead[1],
        gsd_m=np.hypot(40, 26) / camera.frames.focal_px,
    )
    ground = find_ground([replace(camera, frames=frames)], ORIGIN)
    assert len(ground.heights_m) == 20
    assert ground.heights_m == pytest.approx(0.1 * ground.places[:, 0], abs=1e-3)
    assert not len(find_ground([camera], ORIGIN).heights_m)  # without a terrain model


def indexed(folder: Path, plan: FlightPlan) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Anomalies and conductors of a flight."""
    store, truth = Store(folder), truth_of(plan)
    inspected.write_truth(store, "flight", truth, np.random.default_rng(1))
    import_spans(store, inspected.spans_of(truth))
    index.publish(store)
    return select(store, "SELECT * FROM anomalies"), select(store, "SELECT * FROM conductors")


@pytest.mark.slow
@pytest.mark.parametrize("flown", [FlightKind.PASS_BY, FlightKind.ORBIT])
def test_conductors_over_hills_are_where_they_hang(tmp_path: Path, flown: FlightKind) -> None:
    plan = plan_flight(replace(HILLS, flight=flown))
    anomalies, rows = indexed(tmp_path, plan)
    assert anomalies == []
    line, errors_m = plan.line, []
    for i in range(line.n_structures - 1):
        first, last = np.searchsorted(line.along, line.structures_along[i : i + 2]).tolist()
        feet_m = np.array([one.foot[2] for one in line.structures[i : i + 2]])
        own = [row for row in rows if row["span_id"] == plan.span_id(i)]
        for row in own:
            raised_m = row["raised_m"] + inspected.CONDUCTOR_HEIGHT_M
            true_m = [np.mean(c.points[[first, last], 2] - feet_m) for c in line.conductors]
            errors_m.append(np.abs(raised_m - np.array(true_m)).min())
    assert len(errors_m) >= 4
    assert np.median(errors_m) < 0.5
    # An orbit on a slope does not see how high the next structures stand, of which sags follow.
    assert {row["sag_m"] is None for row in rows} == {flown == FlightKind.ORBIT}


@pytest.mark.slow
def test_a_conductor_missing_over_hills_is_found(tmp_path: Path) -> None:
    plan = plan_flight(replace(HILLS, faults=(FaultKind.MISSING_CONDUCTOR,)))
    (fault,) = truth_of(plan).faults
    found, _ = indexed(tmp_path, plan)
    assert [(one["kind"], one["span_id"]) for one in found] == [("conductor_count", fault.span_id)]
