"""Pages of flights, read by an HTML parser: whole, safe, and the same numbers as the index."""

from __future__ import annotations

import re
import shutil
from typing import TYPE_CHECKING

import flights as made
import inspected
import pytest
from pages import Page, check

from inspect_pipeline import publishing
from inspect_pipeline.index import publish as index
from inspect_pipeline.index.reading import select
from inspect_pipeline.inspection.spans import import_spans
from inspect_pipeline.report.flight_page import render_flight
from inspect_pipeline.report.store_page import render_store, write_reports
from inspect_pipeline.simulation.options import FaultKind, SimulationOptions
from inspect_pipeline.simulation.truth import simulate_truth
from inspect_pipeline.store.feedback import add_review
from inspect_pipeline.store.store import Store

if TYPE_CHECKING:
    from pathlib import Path

TRUTH = simulate_truth(
    SimulationOptions(16, 4, seed=11, faults=(FaultKind.MISSING_CONDUCTOR, FaultKind.DARK))
)
HOSTILE = "<script>alert(1)</script>\x1b[31m\"'&\u202e"


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    store = Store(tmp_path_factory.mktemp("report"))
    inspected.write_truth(store, "faulty", TRUTH)
    made.write_flight(store, HOSTILE)
    import_spans(store, inspected.spans_of(TRUTH))
    index.publish(store)
    return store


def test_the_page_of_a_flight_with_a_fault(store: Store) -> None:
    flight_id = made.flight_id_of("faulty")
    page = Page(render_flight(store, flight_id))
    check(page)
    (row,) = select(
        store, "SELECT * FROM anomalies WHERE kind = 'conductor_count' AND flight_id = ?", [flight_id]
    )
    assert page.text.count(row["reason"]) >= 2  # first among the findings to decide, and with its evidence
    assert (
        page.text.index("Findings to decide")
        < page.text.index(row["reason"])
        < page.text.index("Usable frames")
    )
    assert f"finding-{row['anomaly_id']}" in page.ids
    (summary,) = select(store, "SELECT span_coverage FROM flight_summary WHERE flight_id = ?", [flight_id])
    assert re.search(rf"Spans seen\s+{100 * summary['span_coverage']:.1f} %", page.text)
    for span in select(store, "SELECT span_id FROM span_coverage WHERE flight_id = ?", [flight_id]):
        assert span["span_id"] in page.text


def test_names_cannot_add_anything_to_a_page(store: Store) -> None:
    flight_id = made.flight_id_of(HOSTILE)
    text = render_flight(store, flight_id)
    page = Page(text)
    check(page)
    assert "alert(1)" in page.text
    assert "\x1b" not in text
    assert "\u202e" not in text
    assert "not known" in page.text


def test_decisions_are_listed(store: Store, tmp_path: Path) -> None:
    (row,) = select(store, "SELECT * FROM anomalies WHERE kind = 'dark_frames'")
    add_review(store, row, "dismissed", "<b>night</b>", "kim")
    index.publish(store)
    page = Page(render_flight(store, row["flight_id"]))
    check(page)
    assert "<b>night</b>" in page.text
    assert re.search(r"dismissed\s*kim", page.text)


def test_the_page_of_a_store_leads_to_those_of_its_flights(store: Store) -> None:
    flight_id = made.flight_id_of("faulty")
    page = Page(render_store(store, {flight_id: "faulty.html"}))
    check(page, ("faulty.html",))
    assert "faulty.html" in page.links
    (row,) = select(store, "SELECT * FROM anomalies WHERE kind = 'conductor_count'")
    assert f"faulty.html#finding-{row['anomaly_id']}" in page.links
    (seen,) = select(store, "SELECT sum(covered_m) / sum(length_m) AS share FROM span_last_seen")
    assert f"{100 * seen['share']:.1f} %" in page.text


def test_reports_are_written_anew_where_something_changed(store: Store, tmp_path: Path) -> None:
    copy = Store(shutil.copytree(store.root, tmp_path / "store"))
    publishing.publish(copy)
    assert write_reports(copy) == 2
    assert write_reports(copy) == 0
    (row,) = select(copy, "SELECT * FROM anomalies WHERE kind = 'conductor_count'")
    add_review(copy, row, "confirmed", "", "kim")
    publishing.publish(copy)
    assert write_reports(copy) == 1
    assert "confirmed by kim" in (copy.root / "reports" / f"{row['flight_id'][:16]}.html").read_text("utf-8")
    copy.remove_flight(row["flight_id"])
    publishing.publish(copy)
    write_reports(copy)
    assert len(list((copy.root / "reports").iterdir())) == 2  # of the other flight, and the index
