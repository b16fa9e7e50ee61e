"""Views: faults and spans that nobody saw, as flights planted them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import duckdb
import flights
import pytest
from stores import ask

from inspect_pipeline.index import publish as index
from inspect_pipeline.index.named_queries import find_query
from inspect_pipeline.inspection.spans import Span, import_spans
from inspect_pipeline.store.store import Store

if TYPE_CHECKING:
    from pathlib import Path


def test_views_find_planted_faults(tmp_path: Path) -> None:
    """Frames 10 to 16 without segments around the bad frame 13; after frame 19, four frames are missing."""
    store = Store(tmp_path)
    flight_id = flights.flight_id_of("planted")
    with store.write_flight(flight_id) as staging, flights.FlightWriter(staging.path, flight_id) as writer:
        rows = flights.TrackedRows(writer)
        for i in range(30):
            step = i if i < 20 else i + 4
            if i == 13:
                rows.add_frame(flights.frame(i, "corrupt JPEG", step=step), None)
            else:
                rows.add_frame(flights.frame(i, step=step), flights.detections(0 if 10 <= i <= 16 else 2))
        staging.commit(flights.record("planted", rows.finish()))
    index.publish(store)
    start = flights.START_NS
    assert ask(store, "SELECT * EXCLUDE (flight_id, start_utc) FROM detection_gaps") == [
        (1, 10, 16, 6, start + 10 * flights.PERIOD_NS, 0.6, None)
    ]
    assert ask(store, "SELECT * EXCLUDE (flight_id, start_utc) FROM frame_dropouts") == [
        (1, 19, 20, start + 19 * flights.PERIOD_NS, 0.5, None, 4)
    ]
    assert ask(store, "SELECT topic, frame_idx, reason FROM bad_frames") == [
        (flights.TOPIC, 13, "corrupt JPEG")
    ]
    assert ask(
        store, "SELECT n_frames_with_segments, detection_share, duration_s, model_name FROM flight_summary"
    ) == [(23, 23 / 29, 3.3, "fast")]


def test_a_span_that_no_flight_has_seen(store: Store) -> None:
    """Flights without positions see no span; the question is answered over all flights."""
    ends = ("L12", "T1", "T2", 47.0, 8.0, None, 47.001, 8.0, None, 111.2, None)
    import_spans(store, [Span("S1", *ends), Span("S2", *ends)])
    index.publish(store)
    assert ask(store, "SELECT span_id, line_id, length_m FROM unseen_spans ORDER BY 1") == [
        ("S1", "L12", 111.2),
        ("S2", "L12", 111.2),
    ]
    assert find_query("unseen").parameters == ()


@pytest.mark.parametrize(("judged_m", "known"), [(80, [(2.0,)]), (0, [])])
def test_a_number_with_an_unknown_conductor_is_not_compared(
    store: Store, judged_m: float, known: list[tuple[float]]
) -> None:
    """Three conductors, one of them absent, of which the last is present or judged nowhere."""
    with duckdb.connect(store.index_path) as connection:
        connection.execute(
            "INSERT INTO span_judgements BY NAME SELECT flight_id, 'S1' AS span_id,"
            " 'conductor_count' AS kind, 'judged' AS outcome, 100 AS length_m FROM flights LIMIT 1"
        )
        for conductor, (judged, present) in enumerate(((90, 90), (90, 0), (judged_m, judged_m)), start=1):
            connection.execute(
                "INSERT INTO conductors BY NAME SELECT flight_id, 1 AS channel_id, 'S1' AS span_id,"
                " ? AS conductor, 9 AS n_frames, ? AS judged_m, ? AS present_m, 0 AS across_m, 0 AS raised_m"
                " FROM flights LIMIT 1",
                (conductor, judged, present),
            )
    assert ask(store, "SELECT value FROM span_states WHERE subject = 'conductors'") == known
