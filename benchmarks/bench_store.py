"""Size of a store and time to maintain it: flights of 500 frames, each with 12 segments and 4 lines.

Coordinates and scores are random, which no compression makes small. The annotated copies are left out: each
is as large as its recording and what bench_append appends.
"""

from __future__ import annotations

import hashlib
import json
import sys
import tempfile
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from measure import conclude, measured

from inspect_pipeline.index import publish as index
from inspect_pipeline.index.flight_tables import FlightWriter
from inspect_pipeline.recording.types import CameraChannel, Frame
from inspect_pipeline.store.records import FlightRecord, ModelRecord, RunRecord
from inspect_pipeline.store.store import Store
from lsnet.segments import Detections, Lines, Segments

if TYPE_CHECKING:
    from inspect_pipeline.store.records import FlightTotals

N_FLIGHTS, N_FRAMES, N_SEGMENTS, N_LINES = 20, 500, 12, 4
START_NS, PERIOD_NS = 1_800_000_000_000_000_000, 100_000_000
IMAGE = np.zeros((1080, 1920, 3), np.uint8)
CHANNEL = CameraChannel(1, "/camera/image/compressed", "foxglove.CompressedImage", "protobuf", N_FRAMES)
MODEL = ModelRecord("fast-1", "fast", "fast", "0" * 64, 0.5)
BARS = {"index_bytes_per_frame": (0.0, 2000.0), "parquet_bytes_per_frame": (0.0, 1000.0)}


def detections(dice: np.random.Generator) -> Detections:
    """Return random segments, and lines of three points."""
    height, width = size = IMAGE.shape[:2]
    scale = np.array([width, height], np.float32)
    endpoints = (dice.random((N_SEGMENTS, 2, 2), np.float32) * scale).reshape(-1, 4)
    points = tuple(dice.random((3, 2), np.float32) * scale for _ in range(N_LINES))
    return Detections(
        Segments(endpoints, dice.random(N_SEGMENTS, np.float32), size),
        Lines(points, dice.random(N_LINES, np.float32), size),
    )


def write_flight(store: Store, run: RunRecord, number: int) -> None:
    """A flight of random rows, without an annotated copy."""
    dice = np.random.default_rng(number)
    flight_id = hashlib.sha256(str(number).encode()).hexdigest()
    with store.write_flight(flight_id) as staging, FlightWriter(staging.path, flight_id) as writer:
        for i in range(N_FRAMES):
            time_ns = START_NS + (number * N_FRAMES + i) * PERIOD_NS
            frame = Frame(1, CHANNEL.topic, i, time_ns, time_ns, time_ns, "camera", IMAGE, None)
            measures = dice.random(3).tolist()
            writer.add_frame(
                frame, detections(dice), infer_ms=measures[0], sharpness=measures[1], mean_luma=measures[2]
            )
        staging.commit(_record(flight_id, run, writer.finish()))


def _record(flight_id: str, run: RunRecord, totals: FlightTotals) -> FlightRecord:
    return FlightRecord(
        flight_id=flight_id,
        source_uri=f"file:///inbox/{flight_id}.mcap",
        source_bytes=0,
        status="ok",
        reason=None,
        warnings=(),
        annotations=None,
        ingested_at=datetime.now(UTC),
        run=run,
        model=MODEL,
        channels=(CHANNEL,),
        totals=totals,
    )


def main() -> int:
    """Fill a store, publish it at once, add a flight, compare."""
    with tempfile.TemporaryDirectory() as folder:
        store = Store(Path(folder) / "store")
        run = RunRecord("6f1c1c52-0b1e-4c62-9d2b-2f0f8f2d9a11", datetime.now(UTC), "bench", "0", "0" * 64, {})
        for number in range(N_FLIGHTS):
            write_flight(store, run, number)
        parquet_bytes = sum(path.stat().st_size for path in store.root.rglob("*.parquet"))
        publish = measured(lambda: index.publish(store))
        index_bytes = store.index_path.stat().st_size
        write_flight(store, run, N_FLIGHTS)
        started = time.perf_counter()
        index.publish(store)
        one_more_s = time.perf_counter() - started
        verify = measured(lambda: verify(store))
    n_frames = N_FLIGHTS * N_FRAMES
    figures = {
        "n_frames": n_frames,
        "parquet_bytes_per_frame": parquet_bytes / n_frames,
        "index_bytes_per_frame": index_bytes / n_frames,
        "publish_s": publish.seconds,
        "publish_one_more_s": one_more_s,
        "publish_peak_mb": publish.peak_bytes / 2**20,
        "verify_s": verify.seconds,
        "verify_peak_mb": verify.peak_bytes / 2**20,
    }
    print(json.dumps({"n_flights": N_FLIGHTS, "n_segments": N_SEGMENTS, "n_lines": N_LINES}))
    return conclude("store", figures, BARS)


if __name__ == "__main__":
    sys.exit(main())
