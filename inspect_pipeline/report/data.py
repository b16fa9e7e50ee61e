"""What the index says about a flight, as a report needs it. Nothing is computed that the index has."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from inspect_pipeline.index.anomalies import list_anomalies
from inspect_pipeline.index.flights import describe_flights
from inspect_pipeline.index.reading import open_index
from inspect_pipeline.inspection.rules import PRIORITIES

if TYPE_CHECKING:
    from inspect_pipeline.store.store import Store

Row = dict[str, Any]

_SETTINGS = """
SELECT f.start_ns, f.end_ns, f.reason, f.source_bytes, m.name AS model, m.preset, m.weights_sha256,
       m.score_threshold, r.config::VARCHAR AS config, r.app_version, r.host, r.command, r.started_at
FROM flights AS f
LEFT JOIN models AS m USING (model_id)
LEFT JOIN runs AS r USING (run_id)
WHERE f.flight_id = ?
"""
_COVERAGE = "SELECT * FROM coverage WHERE flight_id = ? AND channel_id IS NULL AND kind <> 'span'"
_UNPLACED = "SELECT reason FROM coverage WHERE flight_id = ? AND kind = 'span' AND span_id IS NULL"
_SPANS = """
SELECT s.*, c.imaged_m, c.covered_m, c.share, c.unknown_m, c.reason, c.passed_m, c.longest_gap_m
FROM span_coverage AS c
JOIN spans AS s USING (span_id)
WHERE c.flight_id = ?
ORDER BY s.line_id, s.span_id
"""
_JUDGED = """
SELECT span_id, kind, length_m, judged_m, why_not FROM span_judged WHERE flight_id = ? ORDER BY span_id, kind
"""
# Neighbouring bins of one state are one stretch, from bin `first` to before bin `stop` of `n_bins`.
_STRETCHES = """
WITH bins AS (
    SELECT span_id,
           bin_idx,
           CASE WHEN n_detected > 0 THEN 'seen'
                WHEN n_frames > 0 THEN 'shown'
                WHEN is_unknown THEN 'unknown'
                ELSE 'unseen' END               AS state,
           count(*) OVER (PARTITION BY span_id) AS n_bins
    FROM coverage_bins
    WHERE flight_id = ? AND kind = 'span'
),
numbered AS (
    SELECT *, bin_idx - row_number() OVER (PARTITION BY span_id, state ORDER BY bin_idx) AS island FROM bins
)
SELECT span_id, state, min(bin_idx) AS first, max(bin_idx) + 1 AS stop, any_value(n_bins) AS n_bins
FROM numbered
GROUP BY span_id, state, island
ORDER BY span_id, first
"""
_FRAMES = """
SELECT f.channel_id, f.frame_idx, f.log_time_ns, f.status, f.n_lines, f.sharpness, f.height_m,
       f.lat_deg, f.lon_deg, c.n_conductors
FROM frames AS f
LEFT JOIN (
    SELECT flight_id, channel_id, frame_idx, max(n_conductors) AS n_conductors
    FROM conductor_counts
    WHERE flight_id = $1
    GROUP BY ALL
) AS c USING (flight_id, channel_id, frame_idx)
WHERE f.flight_id = $1
ORDER BY f.log_time_ns, f.channel_id
"""
_CONDUCTORS = """
SELECT c.*, h.topic
FROM conductors AS c
LEFT JOIN channels AS h USING (flight_id, channel_id)
JOIN spans AS s USING (span_id)
WHERE c.flight_id = ?
ORDER BY s.line_id, c.span_id, c.channel_id, c.conductor
"""
_GAPS = "SELECT * FROM coverage_gaps WHERE flight_id = ? ORDER BY start_ns, kind"
_CHANNELS = "SELECT * FROM channels WHERE flight_id = ? ORDER BY channel_id"


@dataclass(frozen=True, slots=True)
class FlightData:
    """Rows of the index about a flight, and the warnings of its record."""

    flight: Row
    settings: Row
    warnings: tuple[str, ...]
    channels: list[Row]
    coverage: list[Row]
    spans: list[Row]
    unplaced_reason: str | None
    judged: list[Row]
    stretches: list[Row]
    frames: list[Row]
    gaps: list[Row]
    conductors: list[Row]
    anomalies: list[Row]

    @property
    def flight_id(self) -> str:
        """The flight_id."""
        return str(self.flight["flight_id"])


def load_flight(store: Store, flight_id: str) -> FlightData:
    """Read what a report shows of a flight. Anomalies are in order of priority, then of time.

    Raises StoreError.
    """
    with open_index(store) as index:
        rows = {
            name: index.select(sql, [flight_id])
            for name, sql in {
                "channels": _CHANNELS,
                "coverage": _COVERAGE,
                "spans": _SPANS,
                "judged": _JUDGED,
                "stretches": _STRETCHES,
                "frames": _FRAMES,
                "gaps": _GAPS,
                "conductors": _CONDUCTORS,
            }.items()
        }
        (settings,), unplaced = index.select(_SETTINGS, [flight_id]), index.select(_UNPLACED, [flight_id])
    (flight,) = describe_flights(store, [flight_id])
    stored = store.find_flight(flight_id)
    anomalies = list_anomalies(store, [flight_id])
    return FlightData(
        flight=flight,
        settings=settings,
        warnings=stored.record.warnings if stored else (),
        unplaced_reason=unplaced[0]["reason"] if unplaced else None,
        anomalies=sorted(anomalies, key=lambda row: PRIORITIES.index(row["priority"])),
        **rows,
    )
