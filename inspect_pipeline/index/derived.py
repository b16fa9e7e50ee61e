"""The derived part of the index: coverage and anomalies, from the flights' rows and user input.

Computed flight by flight when the index is published, for flights that changed; for all of them when the
spans, the rules or the program changed.
"""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from inspect_pipeline.index.cameras import load_cameras
from inspect_pipeline.index.inspected import Inspected, input_digests, load_store_rules
from inspect_pipeline.index.rows import insert_records
from inspect_pipeline.inspection.anomalies.find import Reviewed, inspect_cameras, with_ids
from inspect_pipeline.inspection.coverage.measure import measure_coverage
from inspect_pipeline.inspection.spans import load_spans
from inspect_pipeline.store.feedback import load_reviews, load_tags

if TYPE_CHECKING:
    from collections.abc import Sequence

    import duckdb

    from inspect_pipeline.inspection.anomalies.counts import CountRows
    from inspect_pipeline.inspection.anomalies.find import Anomaly
    from inspect_pipeline.inspection.coverage.measure import FlightCoverage
    from inspect_pipeline.inspection.rules import Rules
    from inspect_pipeline.inspection.spans import Span
    from inspect_pipeline.store.store import Store


DERIVED_TABLES = (
    "coverage",
    "coverage_bins",
    "coverage_gaps",
    "conductor_counts",
    "anomalies",
    "span_judgements",
    "conductors",
)


def refresh(connection: duckdb.DuckDBPyConnection, store: Store, changed: Sequence[str]) -> None:
    """Update spans, reviews, tags, coverage and anomalies from the flights and files of a store.

    Runs in the transaction of the caller. Raises RulesError, SpansError, StoreError.
    """
    digests = input_digests(store)
    known = dict(connection.execute("SELECT name, sha256 FROM inputs").fetchall())
    is_other = any(known.get(name) != digests[name] for name in ("program", "rules", "spans.geojson"))
    spans, rules = load_spans(store), load_store_rules(store)
    _insert_user_input(connection, store, spans, digests)
    every = connection.execute("SELECT flight_id FROM flights").fetchall() if is_other else ()
    stale = [flight_id for (flight_id,) in every] or list(changed)
    gone = "flight_id NOT IN (SELECT flight_id FROM flights) OR flight_id IN (SELECT unnest(?))"
    for table in DERIVED_TABLES if known else ():  # a new index has no rows
        connection.execute(f"DELETE FROM {table} WHERE {gone}", [stale])
    reviews = _reviewed(store)
    for flight_id in stale:
        cameras = load_cameras(connection, flight_id)
        _insert_coverage(connection, flight_id, measure_coverage(cameras, spans, rules))
        found = inspect_cameras(cameras, spans, rules)
        _insert_counts(connection, flight_id, found.counts)
        anomalies = with_ids(flight_id, found.anomalies, reviews.get(flight_id, []))
        _insert_anomalies(connection, flight_id, anomalies)
        for table, rows in (("span_judgements", found.judgements), ("conductors", found.conductors)):
            records = [{"flight_id": flight_id, **asdict(row)} for row in rows]
            insert_records(connection, f"INSERT INTO {table}", table, records)


def inspect_flights(
    connection: duckdb.DuckDBPyConnection, store: Store, flight_ids: Sequence[str], rules: Rules
) -> Inspected:
    """Compute anomalies and coverage of flights by other rules; raises SpansError, StoreError."""
    spans, reviews = load_spans(store), _reviewed(store)
    anomalies: list[dict[str, Any]] = []
    coverage: list[dict[str, Any]] = []
    judgements: list[dict[str, Any]] = []
    for flight_id in flight_ids:
        cameras, own = load_cameras(connection, flight_id), {"flight_id": flight_id}
        found = inspect_cameras(cameras, spans, rules)
        named = with_ids(flight_id, found.anomalies, reviews.get(flight_id, []))
        anomalies += [own | asdict(one) for one in named]
        judgements += [own | asdict(one) for one in found.judgements]
        numbers = measure_coverage(cameras, spans, rules).numbers
        coverage += [own | asdict(one) | {"share": one.share} for one in numbers if one.channel_id is None]
    return Inspected(anomalies, coverage, judgements)


def _insert_user_input(
    connection: duckdb.DuckDBPyConnection, store: Store, spans: list[Span], digests: dict[str, str]
) -> None:
    """Replace the tables of user input: spans, reviews, tags and the hashes of inputs."""
    own = ("anomaly_id", "verdict", "note", "reviewed_at", "reviewed_by")
    reviews = [{name: getattr(one, name) for name in own} for one in load_reviews(store)]
    tags = [{"flight_id": tag.flight_id, "key": tag.key, "value": tag.value} for tag in load_tags(store)]
    inputs = [{"name": name, "sha256": digest} for name, digest in digests.items()]
    tables = {"spans": [asdict(span) for span in spans], "reviews": reviews, "flight_tags": tags}
    for table, rows in {**tables, "inputs": inputs}.items():
        connection.execute(f"DELETE FROM {table}")
        insert_records(connection, f"INSERT INTO {table}", table, rows)


def _reviewed(store: Store) -> dict[str, list[Reviewed]]:
    """Return the reviewed anomalies by flight."""
    by_flight: dict[str, list[Reviewed]] = {}
    for one in load_reviews(store):
        what = (one.anomaly_id, one.kind, one.channel_id, one.span_id, one.start_ns, one.end_ns)
        by_flight.setdefault(one.flight_id, []).append(Reviewed(*what))
    return by_flight


def _insert_coverage(connection: duckdb.DuckDBPyConnection, flight_id: str, found: FlightCoverage) -> None:
    numbers = [{"flight_id": flight_id, **asdict(one), "share": one.share} for one in found.numbers]
    gaps = [{"flight_id": flight_id, **asdict(one), "duration_s": one.duration_s} for one in found.gaps]
    insert_records(connection, "INSERT INTO coverage", "coverage", numbers)
    insert_records(connection, "INSERT INTO coverage_gaps", "coverage_gaps", gaps)
    for bins in found.bins:
        seen = bins.n_detected > 0
        columns = {
            "bin_idx": np.arange(len(seen)),
            "lat_deg": bins.lat_deg,
            "lon_deg": bins.lon_deg,
            "n_frames": bins.n_frames,
            "n_detected": bins.n_detected,
            "best_gsd_m": bins.best_gsd_m,
            "first_ns": bins.first_ns,
            "last_ns": bins.last_ns,
            "is_seen": seen,
            "is_unknown": bins.is_unknown,
        }
        connection.register("bin_rows", columns)
        connection.execute(
            """
            INSERT INTO coverage_bins BY NAME
            SELECT $flight_id AS flight_id, $kind AS kind, $span_id AS span_id, $bin_m AS length_m,
                   * EXCLUDE (is_seen)
                     REPLACE (if(isnan(best_gsd_m), NULL, best_gsd_m) AS best_gsd_m,
                              if(is_seen, first_ns, NULL) AS first_ns, if(is_seen, last_ns, NULL) AS last_ns)
            FROM bin_rows
            """,
            {"flight_id": flight_id, "kind": bins.kind, "span_id": bins.span_id, "bin_m": bins.bin_m},
        )
        connection.unregister("bin_rows")


def _insert_counts(
    connection: duckdb.DuckDBPyConnection, flight_id: str, counts: Sequence[CountRows]
) -> None:
    if not counts:
        return
    lengths = [len(found.frame_idx) for found in counts]
    columns = {
        "channel_id": np.repeat([found.channel_id for found in counts], lengths),
        "count_idx": np.repeat(np.arange(len(counts)), lengths),
        "frame_idx": np.concatenate([found.frame_idx for found in counts]),
        "n_conductors": np.concatenate([found.n_conductors for found in counts]),
    }
    connection.register("count_rows", columns)
    connection.execute(
        """
        INSERT INTO conductor_counts BY NAME
        SELECT $flight_id AS flight_id, $span_ids[count_idx + 1] AS span_id, * EXCLUDE (count_idx)
        FROM count_rows
        """,
        {"flight_id": flight_id, "span_ids": [found.span_id for found in counts]},
    )
    connection.unregister("count_rows")


def _insert_anomalies(
    connection: duckdb.DuckDBPyConnection, flight_id: str, found: Sequence[Anomaly]
) -> None:
    rows = [{"flight_id": flight_id, **asdict(one)} for one in found]
    insert_records(connection, "INSERT INTO anomalies", "anomalies", rows)
