"""Planted faults in flights that are hard to judge: each is found, in its frames, and nothing else."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import inspected
import numpy as np
import pytest

from inspect_pipeline.index import publish as index
from inspect_pipeline.index.reading import select
from inspect_pipeline.inspection.spans import import_spans
from inspect_pipeline.simulation.options import FaultKind, FlightKind, SchemaKind, SimulationOptions
from inspect_pipeline.simulation.truth import simulate_truth
from inspect_pipeline.store.store import Store

if TYPE_CHECKING:
    from pathlib import Path

    from inspect_pipeline.simulation.records import FlightTruth

pytestmark = pytest.mark.slow  # two seconds or so each

NEUTRAL_BEHIND_PHASES = SimulationOptions(
    40.0, 10.0, (2160, 3840), 9003, n_phases=6, faults=(FaultKind.SAG_OUTLIER,)
)
BUNDLES_IN_SMALL_IMAGES = SimulationOptions(
    40.0, 2.0, (360, 640), 9001, flight=FlightKind.LOSS, n_bundle=4, faults=(FaultKind.BROKEN_CONDUCTOR,)
)
FROM_ALL_SIDES = SimulationOptions(
    40.0, 4.0, (2160, 3840), 9018, flight=FlightKind.ORBIT, faults=(FaultKind.MISSING_CONDUCTOR,)
)
FEW_FRAMES = SimulationOptions(
    40.0, 1.0, (720, 1280), 9008, flight=FlightKind.LOSS, n_circuits=2, faults=(FaultKind.SAG_OUTLIER,)
)
TURNS_WHILE_CIRCLING = SimulationOptions(
    40.0, 1.0, (360, 640), 9006, flight=FlightKind.ORBIT, faults=(FaultKind.ORIENTATION_JUMP,)
)
ENDS_OF_IMAGES_UNDER_NOISE = SimulationOptions(
    40.0,
    2.0,
    (720, 1280),
    9007,
    flight=FlightKind.LOSS,
    n_circuits=2,
    position_noise_m=1.7555402249755792,
    drift_m=0.5945664969328173,
    attitude_noise_deg=1.0,
    faults=(FaultKind.MISSING_CONDUCTOR,),
)
SEEN_IN_PART_ONLY = SimulationOptions(
    40.0,
    1.0,
    (360, 640),
    13006,
    flight=FlightKind.ORBIT,
    schema=SchemaKind.PHOTOGRAPHS,
    n_circuits=2,
    corner_deg=30.0,
    wind_deg=8.0,
    faults=(FaultKind.MISSING_CONDUCTOR,),
)
CROSSED_WHILE_TRACKS_CHANGE = SimulationOptions(
    40.0,
    1.0,
    (720, 1280),
    13014,
    flight=FlightKind.ORBIT,
    hills_m=5.0,
    corner_deg=-30.0,
    faults=(FaultKind.CROSSING_LINE,),
)
WIRE_THAT_LEAVES_ITS_BUNDLE = SimulationOptions(
    40.0,
    1.0,
    (720, 1280),
    13019,
    schema=SchemaKind.PHOTOGRAPHS,
    n_bundle=2,
    corner_deg=30.0,
    faults=(FaultKind.CONDUCTORS_TOO_CLOSE,),
)
HIGH_CONDUCTORS_IN_WIND = SimulationOptions(
    40.0,
    2.0,
    (2160, 3840),
    13019,
    flight=FlightKind.ORBIT,
    n_circuits=2,
    hills_m=5.0,
    corner_deg=-30.0,
    wind_deg=8.0,
    faults=(FaultKind.ORIENTATION_JUMP,),
)
GAP_NEAR_THE_END_OF_A_NOISY_VIEW = SimulationOptions(
    40.0,
    2.0,
    (1080, 1920),
    13020,
    flight=FlightKind.HOVER,
    n_bundle=2,
    position_noise_m=2.620569842821411,
    drift_m=1.8190819548176862,
    attitude_noise_deg=1.0,
    hills_m=5.0,
    wind_deg=8.0,
    faults=(FaultKind.CONDUCTOR_GAP,),
)
GAP_UP_TO_THE_END_OF_A_NOISY_VIEW = SimulationOptions(
    40.0,
    1.0,
    (720, 1280),
    15905,
    flight=FlightKind.HOVER,
    position_noise_m=2.0321749944331455,
    drift_m=0.7362628459251861,
    attitude_noise_deg=1.0,
    hills_m=5.0,
    wind_deg=8.0,
    faults=(FaultKind.CONDUCTOR_GAP,),
)
MISSED_IN_FEW_FRAMES = SimulationOptions(
    40.0, 1.0, (1080, 1920), 13506, flight=FlightKind.LOSS, n_phases=6, hills_m=5.0
)
SAGS_TILTED_BY_NOISE = SimulationOptions(
    40.0,
    2.0,
    (360, 640),
    13545,
    flight=FlightKind.LOSS,
    n_phases=6,
    position_noise_m=1.520193782439941,
    drift_m=0.6960399493112575,
    attitude_noise_deg=1.0,
    hills_m=5.0,
)
FEW_NOISY_FRAMES = SimulationOptions(
    40.0,
    1.0,
    (1080, 1920),
    13019,
    n_phases=6,
    corner_deg=30.0,
    wind_deg=8.0,
    position_noise_m=2.15,
    drift_m=1.5,
    attitude_noise_deg=1.0,
    faults=(FaultKind.MISSING_CONDUCTOR,),
)


@pytest.mark.parametrize(
    ("options", "kind"),
    [
        (NEUTRAL_BEHIND_PHASES, "sag_change"),
        (BUNDLES_IN_SMALL_IMAGES, "conductor_lost"),
        (FROM_ALL_SIDES, "conductor_count"),
        (FEW_FRAMES, "sag_change"),
        (TURNS_WHILE_CIRCLING, "orientation_jump"),
        (ENDS_OF_IMAGES_UNDER_NOISE, "conductor_count"),
        (SEEN_IN_PART_ONLY, "conductor_count"),
        (CROSSED_WHILE_TRACKS_CHANGE, "crossing_line"),
        (WIRE_THAT_LEAVES_ITS_BUNDLE, "conductors_converging"),
        (HIGH_CONDUCTORS_IN_WIND, "orientation_jump"),
        (GAP_NEAR_THE_END_OF_A_NOISY_VIEW, "conductor_gap"),
        (GAP_UP_TO_THE_END_OF_A_NOISY_VIEW, "conductor_gap"),
        (FEW_NOISY_FRAMES, "conductor_count"),
    ],
)
def test_the_planted_fault_is_found_alone(tmp_path: Path, options: SimulationOptions, kind: str) -> None:
    truth = simulate_truth(options)
    found = anomalies(tmp_path, truth)
    (fault,) = truth.faults
    assert [(one["kind"], one["span_id"]) for one in found] == [(kind, fault.span_id)]
    common = min(found[0]["end_ns"], fault.end_ns) - max(found[0]["start_ns"], fault.start_ns)
    whole = max(found[0]["end_ns"], fault.end_ns) - min(found[0]["start_ns"], fault.start_ns)
    assert common >= whole / 2


@pytest.mark.parametrize("options", [MISSED_IN_FEW_FRAMES, SAGS_TILTED_BY_NOISE])
def test_nothing_is_found_where_nothing_is(tmp_path: Path, options: SimulationOptions) -> None:
    assert anomalies(tmp_path, simulate_truth(options)) == []


def anomalies(folder: Path, truth: FlightTruth) -> list[dict[str, Any]]:
    store = Store(folder)
    inspected.write_truth(store, "flight", truth, np.random.default_rng(truth.options.seed))
    import_spans(store, inspected.spans_of(truth))
    index.publish(store)
    return select(store, "SELECT kind, span_id, start_ns, end_ns FROM anomalies")
