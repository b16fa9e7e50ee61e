"""Flights made for tests: small, planted, the same every time."""

from __future__ import annotations

import hashlib
import json
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import duckdb
import numpy as np

from inspect_pipeline.georeference.frame_pose import FramePose
from inspect_pipeline.index.flight_tables import FlightWriter
from inspect_pipeline.publishing import publish
from inspect_pipeline.recording.types import CameraChannel, Frame
from inspect_pipeline.store.records import FlightRecord, FlightTotals, ModelRecord, RunRecord
from inspect_pipeline.store.store import Store
from inspect_pipeline.tracking.flight import FlightTracker
from lsnet.segments import Detections, Lines, Segments

START_NS = 1_700_000_000_123_456_789
PERIOD_NS = 100_000_000
TOPIC = "/camera"
IMAGE = np.zeros((48, 64, 3), np.uint8)
RUN = RunRecord(
    "6f1c1c52-0b1e-4c62-9d2b-2f0f8f2d9a11",
    datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC),
    "tower",
    "0.1.0",
    "c" * 64,
    {"every": 1},
)
MODEL = ModelRecord("fast-1", "fast", "fast", "d" * 64, 0.5)


def flight_id_of(name: str) -> str:
    return hashlib.sha256(name.encode()).hexdigest()


def detections(n_segments: int) -> Detections:
    """`n_segments` segments, the i-th from (i, 0) to (i + 3, 4), and one line of three points."""
    x = np.arange(n_segments, dtype=np.float32)
    endpoints = np.stack([x, 0 * x, x + 3, 0 * x + 4], 1)
    size = IMAGE.shape[:2]
    points = np.array([[0, 0], [3, 4], [3, 10]], np.float32)
    lines = Lines((points,), np.array([0.75], np.float32), size) if n_segments else Lines.empty(size)
    return Detections(Segments(endpoints, np.full(n_segments, 0.5, np.float32), size), lines)


def frame(frame_idx: int, error: str | None = None, channel_id: int = 1, step: int | None = None) -> Frame:
    """Frame number `frame_idx`, at `step` periods after the start."""
    time_ns = START_NS + PERIOD_NS * (frame_idx if step is None else step)
    image = None if error else IMAGE
    return Frame(channel_id, TOPIC, frame_idx, time_ns, time_ns + 1, time_ns - 7, "optical", image, error)


class TrackedRows:
    """A FlightWriter with the tracker of a flight, as in the pipeline."""

    def __init__(self, writer: FlightWriter) -> None:
        self._writer, self._tracker = writer, FlightTracker()

    def add_frame(self, frame: Frame, found: Detections | None, **measures: Any) -> None:
        place = measures.get("place", FramePose())
        track_ids = self._tracker.follow(frame, found.lines, place) if found else None
        self._writer.add_frame(frame, found, track_ids, **measures)

    def finish(self) -> FlightTotals:
        return self._writer.finish(self._tracker.finish())


def write_rows(folder: Path, flight_id: str, n_frames: int) -> FlightTotals:
    """Frame i has i segments; frame 1 is bad."""
    files, totals = _rows(flight_id, n_frames)
    for name, content in files.items():
        (folder / name).write_bytes(content)
    return totals


@cache
def _rows(flight_id: str, n_frames: int) -> tuple[dict[str, bytes], FlightTotals]:
    """The files of rows by their names, which are made once however many tests have the flight."""
    with TemporaryDirectory() as folder, FlightWriter(Path(folder), flight_id) as writer:
        rows = TrackedRows(writer)
        for i in range(n_frames):
            if i == 1:
                rows.add_frame(frame(i, "corrupt JPEG"), None)
            else:
                rows.add_frame(frame(i), detections(i), infer_ms=2.0 + i, sharpness=10.0)
        totals = rows.finish()
        return {path.name: path.read_bytes() for path in Path(folder).iterdir()}, totals


def write_flight(store: Store, name: str, n_frames: int = 3) -> str:
    """A whole flight; the same name with another number of frames is another result of the same flight."""
    flight_id = flight_id_of(name)
    with store.write_flight(flight_id) as staging:
        (staging.path / "annotated.mcap").write_bytes(name.encode() * 100)
        totals = write_rows(staging.path, flight_id, n_frames)
        staging.commit(record(name, totals))
    return flight_id


def published_store(root: Path, **n_frames: int) -> Store:
    """A published store of flights, given by their names and numbers of frames."""
    store = Store(root)
    for name, count in n_frames.items():
        write_flight(store, name, count)
    publish(store)
    return store


def record(name: str, totals: FlightTotals) -> FlightRecord:
    return FlightRecord(
        flight_id=flight_id_of(name),
        source_uri=f"file:///inbox/{name}.mcap",
        source_bytes=1234,
        status="ok",
        reason=None,
        warnings=(),
        annotations="annotated.mcap",
        ingested_at=datetime(2026, 1, 2, 3, 4, 6, 500_000, tzinfo=UTC),
        run=RUN,
        model=MODEL,
        channels=(CameraChannel(1, TOPIC, "foxglove.CompressedImage", "protobuf", None),),
        totals=totals,
    )


def versions(store: Store) -> dict[str, int]:
    """The number of frames of each visible flight, after checking that its folder is whole."""
    versions = {}
    for folder in (store.root / "flights").iterdir():
        result = json.loads((folder / "result.json").read_text())
        assert {name: (folder / name).stat().st_size for name in result["files"]} == result["files"]
        rows = duckdb.execute(f"SELECT count(*) FROM '{folder}/frames.parquet'").fetchall()
        assert rows == [(result["totals"]["n_frames"],)]
        versions[Path(result["source_uri"]).stem] = result["totals"]["n_frames"]
    return versions


def versions_in_index(store: Store) -> dict[str, int]:
    with duckdb.connect(store.index_path, read_only=True) as connection:
        rows = connection.execute(
            "SELECT source_uri, n_frames, (SELECT count(*) FROM frames WHERE frames.flight_id = f.flight_id)"
            " FROM flights AS f"
        ).fetchall()
    assert all(said == counted for _, said, counted in rows)
    return {Path(uri).stem: count for uri, count, _ in rows}
