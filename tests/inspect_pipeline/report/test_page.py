"""Pages of flights, read by an HTML parser: whole, safe, and the same numbers as the index."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import flights as made
from pages import HOSTILE, Page, check

from inspect_pipeline import publishing
from inspect_pipeline.index.reading import select
from inspect_pipeline.report.flight_page import render_flight
from inspect_pipeline.report.store_page import render_store, write_reports
from inspect_pipeline.store.feedback import add_review

if TYPE_CHECKING:
    from pathlib import Path

    from inspect_pipeline.store.store import Store


def test_the_page_of_a_flight_with_a_fault(template: Store) -> None:
    flight_id = made.flight_id_of("faulty")
    page = Page(render_flight(template, flight_id))
    check(page)
    (row,) = select(
        template, "SELECT * FROM anomalies WHERE kind = 'conductor_gap' AND flight_id = ?", [flight_id]
    )
    assert page.text.count(row["reason"]) >= 2  # first among the findings to decide, and with its evidence
    assert (
        page.text.index("Findings to decide")
        < page.text.index(row["reason"])
        < page.text.index("Usable frames")
    )
    assert f"finding-{row['anomaly_id']}" in page.ids
    (summary,) = select(template, "SELECT span_coverage FROM flight_summary WHERE flight_id = ?", [flight_id])
    assert re.search(rf"Spans seen\s+{100 * summary['span_coverage']:.1f} %", page.text)
    (found,) = select(
        template,
        "SELECT count(*) AS n, count(DISTINCT frame_idx) AS n_frames FROM lines WHERE flight_id = ?",
        [flight_id],
    )
    assert f"{found['n']:,} lines in {found['n_frames']} frames" in page.text
    for span in select(template, "SELECT span_id FROM span_coverage WHERE flight_id = ?", [flight_id]):
        assert span["span_id"] in page.text


def test_names_cannot_add_anything_to_a_page(template: Store) -> None:
    flight_id = made.flight_id_of(HOSTILE)
    text = render_flight(template, flight_id)
    page = Page(text)
    check(page)
    assert "alert(1)" in page.text
    assert "\x1b" not in text
    assert "\u202e" not in text
    assert "not known" in page.text


def test_decisions_are_listed(store: Store, tmp_path: Path) -> None:
    (row,) = select(store, "SELECT * FROM anomalies WHERE kind = 'dark_frames'")
    add_review(store, row, "dismissed", "<b>night</b>", "kim")
    publishing.publish(store)
    page = Page(render_flight(store, row["flight_id"]))
    check(page)
    assert "<b>night</b>" in page.text
    assert re.search(r"dismissed\s*kim", page.text)


def test_the_page_of_a_store_leads_to_those_of_its_flights(template: Store) -> None:
    flight_id = made.flight_id_of("faulty")
    page = Page(render_store(template, {flight_id: "faulty.html"}))
    check(page, ("faulty.html",))
    assert "faulty.html" in page.links
    (row,) = select(template, "SELECT * FROM anomalies WHERE kind = 'conductor_gap'")
    assert f"faulty.html#finding-{row['anomaly_id']}" in page.links
    (seen,) = select(template, "SELECT sum(covered_m) / sum(length_m) AS share FROM span_last_seen")
    assert f"{100 * seen['share']:.1f} %" in page.text


def test_reports_are_written_anew_where_something_changed(store: Store) -> None:
    assert write_reports(store) == 2
    assert write_reports(store) == 0
    (row,) = select(store, "SELECT * FROM anomalies WHERE kind = 'conductor_gap'")
    add_review(store, row, "confirmed", "", "kim")
    publishing.publish(store)
    assert write_reports(store) == 1
    assert "confirmed by kim" in (store.root / "reports" / f"{row['flight_id'][:16]}.html").read_text("utf-8")
    store.remove_flight(row["flight_id"])
    publishing.publish(store)
    write_reports(store)
    assert len(list((store.root / "reports").iterdir())) == 2  # of the other flight, and the index
