"""The page of a store: all flights, what is to decide, and what was ever seen of each span."""

from __future__ import annotations

from typing import TYPE_CHECKING

from inspect_pipeline.index.anomalies import list_anomalies
from inspect_pipeline.index.flights import describe_flights
from inspect_pipeline.index.reading import select
from inspect_pipeline.inspection.rules import PRIORITIES
from inspect_pipeline.report.flight_page import count_open, render_flight
from inspect_pipeline.report.map import draw_map
from inspect_pipeline.report.page import render, write_page
from inspect_pipeline.store.images import source_path

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from inspect_pipeline.store.store import Store

FOLDER, INDEX = "reports", "index.html"  # in the store
_MAX_MARKS = 200  # findings on the map, the most urgent ones

_SPANS = """
SELECT s.*, l.covered_m, l.share, l.n_flights, l.last_ns, NULL AS reason
FROM span_last_seen AS l
JOIN spans AS s USING (span_id)
ORDER BY s.line_id, s.span_id
"""
# As of a flight, with the best that any flight has of a bin.
_STRETCHES = """
WITH bins AS (
    SELECT span_id,
           bin_idx,
           CASE WHEN max(n_detected) > 0 THEN 'seen'
                WHEN max(n_frames) > 0 THEN 'shown'
                WHEN bool_or(is_unknown) THEN 'unknown'
                ELSE 'unseen' END               AS state,
           count(*) OVER (PARTITION BY span_id) AS n_bins
    FROM coverage_bins
    WHERE kind = 'span'
    GROUP BY span_id, bin_idx
),
numbered AS (
    SELECT *, bin_idx - row_number() OVER (PARTITION BY span_id, state ORDER BY bin_idx) AS island FROM bins
)
SELECT span_id, state, min(bin_idx) AS first, max(bin_idx) + 1 AS stop, any_value(n_bins) AS n_bins
FROM numbered
GROUP BY span_id, state, island
UNION ALL
SELECT span_id, 'unseen', 0, 1, 1
FROM spans
WHERE span_id NOT IN (SELECT span_id FROM bins)
ORDER BY span_id, first
"""


def render_store(store: Store, links: Mapping[str, str]) -> str:
    """Return the page of a store.

    Args:
        store: the store.
        links: where the pages of flights are, by flight_id.

    Raises:
        StoreError: there is no index, or it cannot be read.
    """
    flights = [row | {"name": source_path(row["source_uri"]).name} for row in describe_flights(store, [])]
    spans, anomalies = select(store, _SPANS), list_anomalies(store, [])
    is_open = [row for row in anomalies if row["verdict"] == "open"]
    findings = sorted(is_open, key=lambda row: PRIORITIES.index(row["priority"]))
    targets = {row["span_id"]: f"span-{number}" for number, row in enumerate(spans, 1)}
    length_m = sum(row["length_m"] for row in spans)
    return render(
        "store.html",
        flights=flights,
        names={row["flight_id"]: row["name"] for row in flights},
        links=links,
        open_counts=count_open(anomalies),
        n_frames=sum(row["n_frames"] for row in flights),
        n_bad_frames=sum(row["n_bad_frames"] for row in flights),
        spans=spans,
        span_targets=targets,
        seen_share=sum(row["covered_m"] for row in spans) / length_m if length_m else None,
        findings=findings,
        map=draw_map(
            spans=spans,
            stretches=select(store, _STRETCHES),
            frames=[],
            gaps=[],
            anomalies=findings[:_MAX_MARKS],
            targets=targets,
        ),
    )


def write_reports(store: Store, on_page: Callable[[], None] = lambda: None) -> int:
    """Write the pages of flights whose results changed, and the page of the store, into its folder `reports`.

    Returns:
        How many pages of flights were written.

    Raises:
        OutputError, StoreError: a page cannot be written, the index cannot be read.
    """
    flights = [row["flight_id"] for row in select(store, "SELECT flight_id FROM flights ORDER BY flight_id")]
    pages = {flight_id: store.root / FOLDER / f"{flight_id[:16]}.html" for flight_id in flights}
    n_written = 0
    for flight_id, path in pages.items():
        if _is_outdated(path, store, flight_id):
            write_page(path, render_flight(store, flight_id))
            n_written += 1
        on_page()
    links = {flight_id: path.name for flight_id, path in pages.items()}
    write_page(store.root / FOLDER / INDEX, render_store(store, links))
    for path in (store.root / FOLDER).glob("*.html"):
        if path not in pages.values() and path.name != INDEX:
            path.unlink()
    return n_written


def _is_outdated(page: Path, store: Store, flight_id: str) -> bool:
    """Whether a page is missing, or older than the files that are rewritten with whatever it shows."""
    derived = store.flight_dir(flight_id) / "layout.json"
    return not page.exists() or not derived.exists() or page.stat().st_mtime < derived.stat().st_mtime
