"""Report and review in a real browser, Chromium: no request leaves, no error, axe-core finds nothing serious.

Needs node, Chromium (CHROMIUM or /usr/bin/chromium), and the npm packages playwright-core and axe-core in a
folder that NODE_PATH names. Screenshots stay in the folder for temporary files, to be looked at.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import tempfile
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Any

import flights as made
import inspected
import pytest
from factories import make_recording, shots
from fakes import FakeDetector

from inspect_pipeline.inspection.spans import import_spans
from inspect_pipeline.pipeline import process
from inspect_pipeline.publishing import publish
from inspect_pipeline.report.flight_page import render_flight
from inspect_pipeline.report.page import write_page
from inspect_pipeline.report.store_page import render_store
from inspect_pipeline.review.decisions import Publisher
from inspect_pipeline.review.server import ReviewServer
from inspect_pipeline.simulation.options import FaultKind, SimulationOptions
from inspect_pipeline.simulation.truth import simulate_truth
from inspect_pipeline.store.feedback import load_corrections, load_reviews
from inspect_pipeline.store.store import Store

if TYPE_CHECKING:
    from collections.abc import Iterator

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]
CHROMIUM = os.environ.get("CHROMIUM", "/usr/bin/chromium")
SCRIPT = Path(__file__).parent / "helpers" / "browse.js"
HOSTILE = "<script>alert(1)</script><img src=x onerror=alert(2)>\x1b[31m\"'&\u202e" + "long" * 40
FAULTS = (FaultKind.MISSING_CONDUCTOR, FaultKind.CONDUCTOR_GAP, FaultKind.BLUR, FaultKind.DROPOUT)


@pytest.fixture(scope="module")
def screenshots() -> Path:
    folder = Path(tempfile.gettempdir()) / "lsnet_pipe_screenshots"
    folder.mkdir(exist_ok=True)
    return folder


@pytest.fixture(scope="module", autouse=True)
def _needs() -> None:
    packages = [Path(folder) for folder in os.environ.get("NODE_PATH", "").split(":") if folder]
    for name in ("playwright-core", "axe-core"):
        if not any((folder / name).exists() for folder in packages):
            pytest.skip(f"no folder of NODE_PATH has {name}; npm install playwright-core axe-core")
    if shutil.which("node") is None or not Path(CHROMIUM).exists():
        pytest.skip("node or Chromium is missing")


def browse(page: Path, review_url: str, folder: Path) -> dict[str, Any]:
    folder.mkdir(exist_ok=True)
    done = subprocess.run(
        ["node", str(SCRIPT), str(page), review_url, str(folder)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return json.loads(done.stdout)


def check(seen: dict[str, Any], page: Path, review_url: str = "\0") -> None:
    assert seen["problems"] == []
    assert seen["violations"] == []
    assert seen["wide"] == []
    allowed = (page.as_uri(), "data:", review_url.rstrip("/"))
    assert [url for url in seen["requests"] if not url.startswith(allowed)] == []


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    store = Store(tmp_path_factory.mktemp("browser"))
    truth = simulate_truth(SimulationOptions(40, 4, seed=7, faults=FAULTS))
    inspected.write_truth(store, HOSTILE, truth)
    made.write_flight(store, "nothing found")
    import_spans(store, inspected.spans_of(truth))
    publish(store)
    return store


@pytest.mark.parametrize("name", [HOSTILE, "nothing found"])
def test_the_page_of_a_flight(store: Store, screenshots: Path, tmp_path: Path, name: str) -> None:
    page = tmp_path / "report.html"
    write_page(page, render_flight(store, made.flight_id_of(name)))
    seen = browse(page, "", screenshots / ("faulty" if name == HOSTILE else "nothing"))
    check(seen, page)
    assert (seen["plain"] >= 3) == (name == HOSTILE)
    assert seen["target"].startswith("#finding-") == (name == HOSTILE)


def test_the_page_of_a_store(store: Store, screenshots: Path, tmp_path: Path) -> None:
    page = tmp_path / "report.html"
    write_page(page, render_store(store, {}))
    check(browse(page, "", screenshots / "store"), page)


@pytest.fixture
def server(tmp_path: Path) -> Iterator[ReviewServer]:
    """Of a flight whose pictures exist, each frame of which is an anomaly."""
    store = Store(tmp_path / "store")
    make_recording(tmp_path / "a.mcap", shots(6))
    flight_id = process(tmp_path / "a.mcap", store, FakeDetector()).flight_id
    (store.root / "rules.toml").write_text("[frames]\noverexposed_above_luma = 0.0\n")
    publish(store)
    with Publisher(store) as publisher, ReviewServer(store, flight_id, publisher) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield server
        server.shutdown()
        thread.join()


def test_review(server: ReviewServer, screenshots: Path, tmp_path: Path) -> None:
    page = tmp_path / "report.html"
    write_page(page, render_flight(server.store, server.flight_id))
    seen = browse(page, server.url, screenshots / "review")
    check(seen, page, server.url)
    assert (seen["verdict"], seen["form"]) == ("confirmed", "dismissed")
    assert "seen from the ground" in seen["decisions"]
    reviews = [(one.verdict, one.note) for one in load_reviews(server.store)]
    assert reviews == [("confirmed", "seen from the ground"), ("dismissed", "")]
    (correction,) = load_corrections(server.store)
    assert len(correction.lines[-1]) == 2
