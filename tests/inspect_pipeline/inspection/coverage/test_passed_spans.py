"""The coverage of a flight over its spans, worked out by hand: spans count of which half was passed."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import flights
import numpy as np
import pyproj
import pytest

from inspect_pipeline.georeference.frame_pose import FramePose
from inspect_pipeline.index import publish as index
from inspect_pipeline.index.flight_tables import FlightWriter
from inspect_pipeline.index.reading import select
from inspect_pipeline.inspection.spans import Span, import_spans
from inspect_pipeline.recording.types import Frame
from inspect_pipeline.store.store import Store
from lsnet.segments import Detections, Lines, Segments

if TYPE_CHECKING:
    from pathlib import Path

SIZE, FOCAL_PX, HEIGHT_M, CONDUCTORS_M = (1000, 800), 500.0, 32.0, 12.0
SPAN_M, REACH_M, NEAR_M = 200, 15, 40  # 15 m ahead, conductors 20 m below are 25 m away: 5 cm a pixel


def north(metres: float) -> float:
    """The latitude so far north of 52 degrees."""
    return pyproj.Geod(ellps="WGS84").fwd(5.0, 52.0, 0.0, metres)[1]


def fly_to(store: Store, end_m: int) -> None:
    """Straight down along two spans from the start of the first, a line in the middle of every picture."""
    flight_id = flights.flight_id_of("north")
    points = np.array([[400, 0], [400, 1000]], np.float32)
    scores = np.array([0.9], np.float32)
    found = Detections(Segments(points.reshape(1, 4), scores, SIZE), Lines((points,), scores, SIZE))
    image = np.broadcast_to(np.uint8(0), (*SIZE, 3))
    with store.write_flight(flight_id) as staging, FlightWriter(staging.path, flight_id) as writer:
        rows = flights.TrackedRows(writer)
        for i, metres in enumerate(range(0, end_m + 1, 2)):
            times = (flights.START_NS + i * flights.PERIOD_NS,) * 3
            place = FramePose(
                lat_deg=north(metres),
                lon_deg=5.0,
                height_m=HEIGHT_M,
                cam_yaw_deg=0.0,
                cam_pitch_deg=-90.0,
                cam_roll_deg=0.0,
                pose_age_ms=0.0,
                attitude_source="camera",
                focal_px=FOCAL_PX,
            )
            frame = Frame(1, flights.TOPIC, i, *times, "camera", image)
            rows.add_frame(frame, found, infer_ms=1.0, sharpness=200.0, mean_luma=100.0, place=place)
        staging.commit(flights.record("north", rows.finish()))
    import_spans(
        store,
        [
            Span(
                f"S{i}",
                "L1",
                f"P{i}",
                f"P{i + 1}",
                north(i * SPAN_M),
                5.0,
                CONDUCTORS_M,
                north((i + 1) * SPAN_M),
                5.0,
                CONDUCTORS_M,
                SPAN_M,
                1,
            )
            for i in range(2)
        ],
    )
    (store.root / "rules.toml").write_text("[coverage]\nsag_share = 0.0\n")
    index.publish(store)


@pytest.mark.parametrize(
    ("end_m", "share"),
    [
        (120, 135 / 200),  # the second span is not reached
        (240, 1.0),  # 80 m of the second are passed: it does not count
        (262, (200 + 77) / 400),  # 102 m are
        (400, 1.0),
    ],
)
def test_spans_count_of_which_half_was_passed(
    tmp_path: Path, bare_flights: None, end_m: int, share: float
) -> None:
    store = Store(tmp_path)
    fly_to(store, end_m)
    rows = select(store, "SELECT * FROM coverage WHERE kind = 'span' ORDER BY span_id")
    passed = [max(0, min(SPAN_M, end_m + NEAR_M - i * SPAN_M)) for i in range(2)]
    covered = [max(0, min(SPAN_M, end_m + REACH_M - i * SPAN_M)) for i in range(2)]
    assert [row["passed"] for row in rows] == pytest.approx([n for n in passed if n], abs=1)
    assert [row["covered"] for row in rows] == pytest.approx(covered[: len(rows)], abs=1)
    assert {json.loads(row["thresholds"])["near_m"] for row in rows} == {NEAR_M}
    (summary,) = select(store, "SELECT span_coverage FROM flight_summary")
    assert summary["span_coverage"] == pytest.approx(share, abs=0.01)
