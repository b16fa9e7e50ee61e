"""Pictures of a flight: where the mark is, what is made once and kept, and how many bytes they have."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import flights as made
import numpy as np
import pytest

from inspect_pipeline import publishing
from inspect_pipeline.index.reading import select
from inspect_pipeline.report import thumbnails
from inspect_pipeline.report.evidence import load_evidence
from inspect_pipeline.report.flight_page import render_flight
from inspect_pipeline.report.thumbnails import encode_small

if TYPE_CHECKING:
    from collections.abc import Iterator

    from inspect_pipeline.simulation.records import FlightTruth
    from inspect_pipeline.store.store import Store

FLIGHT = made.flight_id_of("faulty")


@pytest.fixture
def _images(monkeypatch: pytest.MonkeyPatch, truth: FlightTruth) -> None:
    """The recording is not there: its images are grey."""

    def read(_source: object, wanted: dict[tuple[str, int], int]) -> Iterator[tuple[str, int, np.ndarray]]:
        for topic, frame_idx in wanted:
            yield topic, frame_idx, np.full((*truth.frames[0].image_size, 3), 90, np.uint8)

    monkeypatch.setattr(thumbnails, "open_images", lambda *_: None)
    monkeypatch.setattr(thumbnails, "iter_images", read)


def test_the_mark_is_on_the_fault(template: Store, truth: FlightTruth) -> None:
    """On the axis of the span it is within two metres of where the truth says that a conductor ends."""
    (row,) = select(template, "SELECT * FROM anomalies WHERE kind = 'conductor_gap'")
    found = load_evidence(template, FLIGHT).of_anomalies[row["anomaly_id"]]
    (frame,) = (one for one in truth.frames if one.frame_idx == found.frame_idx)
    (fault,) = (one for one in truth.faults if one.span_id)
    broken = [line.points for line in frame.lines if line.conductor_id in fault.conductor_ids]
    ends = np.vstack([points[[0, -1]] for points in broken])
    x, y, radius = found.mark
    assert np.hypot(*(ends - (x, y)).T).min() < 2 * radius
    assert 0 <= found.crop.left <= x <= found.crop.left + found.crop.side <= found.width


@pytest.mark.usefixtures("_images")
def test_pictures_are_made_once_and_removed_when_not_needed(store: Store) -> None:
    publishing.rebuild(store)
    folder = store.flight_dir(FLIGHT) / "pictures"
    pictures = {path.name: path.stat().st_mtime_ns for path in folder.iterdir()}
    assert len(pictures) >= 3
    (folder / "9-9.jpg").write_bytes(b"of an anomaly that is no more")
    (folder / min(pictures)).unlink()
    publishing.rebuild(store)
    again = {path.name: path.stat().st_mtime_ns for path in folder.iterdir()}
    assert again.keys() == pictures.keys()
    assert {name for name in again if again[name] != pictures[name]} == {min(pictures)}
    page = render_flight(store, FLIGHT)
    assert page.count("data:image/jpeg;base64,") >= len(pictures)
    assert "No picture" not in page


def test_a_page_says_which_pictures_it_lacks(template: Store) -> None:
    page = render_flight(template, FLIGHT)
    assert "neither the annotated copy nor the recording is there any more" in page
    assert "data:image" not in page


@pytest.mark.parametrize("size", [(1080, 1920), (300, 200), (4, 3), (40, 4000)])
def test_pictures_have_few_bytes_whatever_they_show(size: tuple[int, int]) -> None:
    noise = np.random.default_rng(1).integers(0, 256, (*size, 3)).astype(np.uint8)
    data = encode_small(noise, 520, 9000)
    height, width = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR).shape[:2]
    assert len(data) <= 9000
    assert max(height, width) <= min(520, max(size))
