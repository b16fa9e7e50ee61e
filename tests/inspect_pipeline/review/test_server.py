"""The server of `review`, asked over HTTP: what it records, and whom it refuses."""

from __future__ import annotations

import json
import threading
from contextlib import closing
from http.client import HTTPConnection
from typing import TYPE_CHECKING
from urllib.parse import urlencode, urlsplit

import cv2
import numpy as np
import pytest
from factories import make_recording, shots
from fakes import FakeDetector
from pages import Page, check

from inspect_pipeline.export.corrections import export_corrections
from inspect_pipeline.index.reading import select
from inspect_pipeline.pipeline import process
from inspect_pipeline.publishing import publish
from inspect_pipeline.review.decisions import Publisher
from inspect_pipeline.review.server import ReviewServer
from inspect_pipeline.store.feedback import load_corrections, load_reviews
from inspect_pipeline.store.store import Store
from lsnet.training.labels import load_labels

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    folder = tmp_path_factory.mktemp("review")
    store = Store(folder / "store")
    make_recording(folder / "a.mcap", shots(4))
    process(folder / "a.mcap", store, FakeDetector())
    (store.root / "rules.toml").write_text("[frames]\noverexposed_above_luma = 0.0\n")
    publish(store)
    return store


@pytest.fixture
def server(store: Store) -> Iterator[ReviewServer]:
    with Publisher(store) as publisher, ReviewServer(store, None, publisher) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
        thread.start()
        yield server
        server.shutdown()
        thread.join()


def ask(url: str, fields: dict[str, str] | None = None, **headers: str) -> tuple[int, bytes]:
    """Status and body of the answer to a GET, or with fields to a POST."""
    parts = urlsplit(url)
    with closing(HTTPConnection(parts.hostname or "", parts.port)) as connection:
        body = None if fields is None else urlencode(fields)
        connection.request("GET" if body is None else "POST", parts.path, body, headers)
        answer = connection.getresponse()
        return answer.status, answer.read()


def page_at(url: str) -> Page:
    status, body = ask(url)
    assert status == 200, body
    return Page(body.decode())


def test_decisions_are_recorded_and_shown(store: Store, server: ReviewServer) -> None:
    (row,) = select(store, "SELECT anomaly_id, flight_id FROM anomalies LIMIT 1")
    first = page_at(server.url)
    address = next(link for link in first.links if "/flight/" in link)
    fields = {"anomaly_id": row["anomaly_id"], "verdict": "confirmed", "note": "<i>here</i>"}
    answer = json.loads(ask(server.url + "mark", fields, Accept="application/json")[1])
    assert (answer["verdict"], answer["note"]) == ("confirmed", "<i>here</i>")
    (review,) = load_reviews(store)
    assert (review.anomaly_id, review.verdict, review.note) == tuple(fields.values())
    page = page_at(server.url.partition("/" + server.token)[0] + address.partition("#")[0])
    assert "<i>here</i>" in page.text  # without a script, after the publish in the background
    assert "form-action 'self'" in page.policy
    assert ask(server.url + "mark", fields | {"verdict": "open"})[0] == 303  # to the page, for a form
    assert load_reviews(store) == []


def test_corrected_lines_are_labels_for_training(store: Store, server: ReviewServer, tmp_path: Path) -> None:
    (row,) = select(store, "SELECT flight_id, channel_id, width, height FROM frames WHERE frame_idx = 2")
    address = f"{server.url}frame/{row['flight_id'][:16]}/{row['channel_id']}/2"
    check(page_at(address), (f"/{server.token}/",))
    _, picture = ask(address.replace("/frame/", "/picture/") + ".jpg")
    image = cv2.imdecode(np.frombuffer(picture, np.uint8), cv2.IMREAD_COLOR)
    assert image.shape[:2] == (row["height"], row["width"])
    lines = [[[1, 2], [9, 5.5]], [[0, 0], [5, 5], [99, 8]]]
    ask(address, {"lines": json.dumps(lines)})
    (correction,) = load_corrections(store)
    assert correction.lines == [[[1, 2], [9, 5.5]], [[0, 0], [5, 5], [row["width"], 8]]]
    for form in ("labelme", "coco"):
        assert export_corrections(store, {row["flight_id"]}, tmp_path / form, form) == (1, ())
        (labelled,) = load_labels(tmp_path / form)
        assert [line.tolist() for line in labelled.lines] == correction.lines
        assert labelled.load().shape == image.shape
    assert "corrected before" in page_at(address).text
    ask(address, {"lines": "[]"})
    assert load_corrections(store)[0].lines == []


NO_LINES = ["", "{", "[[[0, 0]]]", "[[[0, 0], [1, NaN]]]", "[[0, 1]]", "[" * 9999, '["ab"]']


@pytest.mark.parametrize("text", NO_LINES)
def test_what_is_no_line_is_refused(store: Store, server: ReviewServer, text: str) -> None:
    (row,) = select(store, "SELECT flight_id, channel_id FROM frames WHERE frame_idx = 0")
    before = load_corrections(store)
    address = f"{server.url}frame/{row['flight_id'][:16]}/{row['channel_id']}/0"
    assert ask(address, {"lines": text})[0] == 400
    assert load_corrections(store) == before


def test_others_are_refused(store: Store, server: ReviewServer) -> None:
    (row,) = select(store, "SELECT anomaly_id FROM anomalies LIMIT 1")
    fields = {"anomaly_id": row["anomaly_id"], "verdict": "dismissed"}
    root = server.url.partition("/" + server.token)[0]
    for url, headers, code in (
        (root + "/", {}, 404),
        (root + "/mark", {}, 404),
        (root + "/x" * 9 + "/mark", {}, 404),
        (server.url + "nothing", {}, 404),
        (server.url + "../mark", {}, 404),
        (server.url + "mark", {"Host": "attacker.example"}, 403),
        (server.url + "mark", {"Origin": "https://attacker.example"}, 403),
        (server.url + "mark", {"Origin": "null"}, 403),
    ):
        assert ask(url, fields, **headers)[0] == code, url
    for wrong in ({"verdict": "maybe"}, {"anomaly_id": "none"}, {"anomaly_id": ""}):
        assert ask(server.url + "mark", fields | wrong)[0] in (400, 404)
    assert ask(server.url + "mark", {"note": "x"}, **{"Content-Length": "9999999"})[0] == 413
    assert load_reviews(store) == []
    assert server.server_address[0] == "127.0.0.1"
