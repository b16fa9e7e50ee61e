"""Pages of flights, read by an HTML parser: whole, safe, and the same numbers as the index."""

from __future__ import annotations

import base64
import hashlib
import re
from html.parser import HTMLParser
from typing import TYPE_CHECKING

import flights as made
import inspected
import pytest

from inspect_pipeline.index import publish as index
from inspect_pipeline.index.reading import select
from inspect_pipeline.inspection.spans import import_spans
from inspect_pipeline.report.page import render_flight
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
_VOID = {"meta", "br", "img", "link", "input", "hr"}


class Page(HTMLParser):
    """What a page holds; tags that do not match are refused."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.ids: list[str] = []
        self.links: list[str] = []
        self.scripts: list[str] = []
        self.styles: list[str] = []
        self.attributes: set[str] = set()
        self.policy = ""
        self.text = ""
        self._open: list[str] = []
        self.feed(text)
        self.close()
        assert self._open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        self.attributes |= set(values)
        self.ids += [values["id"]] if values.get("id") else []
        self.links += [values[name] for name in ("href", "src") if values.get(name)]
        if values.get("http-equiv") == "Content-Security-Policy":
            self.policy = values["content"] or ""
        if tag not in _VOID:
            self._open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        self.handle_endtag(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag not in _VOID:
            assert self._open.pop() == tag

    def handle_data(self, data: str) -> None:
        inside = self._open[-1] if self._open else ""
        if inside in ("script", "style"):
            (self.scripts if inside == "script" else self.styles).append(data)
        else:
            self.text += data


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    store = Store(tmp_path_factory.mktemp("report"))
    inspected.write_truth(store, "faulty", TRUTH)
    made.write_flight(store, HOSTILE)
    import_spans(store, inspected.spans_of(TRUTH))
    index.publish(store)
    return store


def check(page: Page) -> None:
    """Links lead to elements of the page, ids are unique, nothing is loaded, only hashed code runs."""
    assert len(page.ids) == len(set(page.ids))
    assert all(link.startswith("data:") or link[1:] in page.ids for link in page.links), page.links
    assert not [name for name in page.attributes if name.startswith("on") or name == "style"]
    for kind, (code,) in {"script-src": page.scripts, "style-src": page.styles}.items():
        digest = base64.b64encode(hashlib.sha256(code.encode()).digest()).decode()
        assert f"{kind} 'sha256-{digest}'" in page.policy
    assert page.policy.startswith("default-src 'none'")
    assert "unsafe" not in page.policy


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
