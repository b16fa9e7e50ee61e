"""Large inboxes: what is unchanged is not looked at again, and a long night takes no more memory."""

from __future__ import annotations

import hashlib
import json
import os
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from factories import Shot, make_recording
from stubs import MakeStub

from inspect_pipeline.batch.inbox import Candidate
from inspect_pipeline.batch.options import BatchOptions
from inspect_pipeline.batch.processed_files import StatCache
from inspect_pipeline.batch.run import run_batch
from inspect_pipeline.batch.worker import Job
from inspect_pipeline.config import ProcessOptions
from inspect_pipeline.store.store import Store

if TYPE_CHECKING:
    from collections.abc import Callable

    from inspect_pipeline.store.records import FlightRecord
    from inspect_pipeline.store.runs import RunSummary

pytestmark = [pytest.mark.reliability, pytest.mark.timeout(7200)]


def run(folder: Path, on_done: Callable[[], object] = lambda: None) -> RunSummary:
    """A batch over the inbox in a folder, into the store in it."""
    store = Store(folder / "store")

    def report(event: str, **fields: object) -> None:
        if event == "recording done":
            on_done()

    job = Job(store.root, ProcessOptions(), MakeStub(folder))
    return run_batch(store, job, BatchOptions((str(folder / "inbox"),), settle_s=0), report)


def add_recording(folder: Path, number: int) -> Path:
    """One of one image, unlike those of other numbers."""
    (folder / "inbox").mkdir(exist_ok=True)
    shot = Shot(1, log_time_ns=10**18 + number)
    return make_recording(folder / "inbox" / f"r{number}.mcap", [shot], n_gps_per_shot=0)


def add_as_if_processed(folder: Path, number: int, like: FlightRecord) -> None:
    """A recording with the flight that a batch would make of it, but for a few rows: those of `like`."""
    path, store = add_recording(folder, number), Store(folder / "store")
    flight_id = hashlib.sha256(path.read_bytes()).hexdigest()
    target = store.flight_dir(flight_id)
    target.mkdir()
    for name in like.files:
        os.link(store.flight_dir(like.flight_id) / name, target / name)
    record = replace(like, flight_id=flight_id, source_uri=path.as_uri())
    (target / "result.json").write_text(json.dumps(record.to_json()))
    candidate = Candidate.at(path)
    assert candidate
    StatCache(store).add(candidate, flight_id)


@pytest.mark.parametrize("n_recordings", [40, pytest.param(10_000, marks=pytest.mark.slow)])
def test_an_unchanged_inbox(tmp_path: Path, n_recordings: int) -> None:
    first = add_recording(tmp_path, 0)
    assert run(tmp_path).counts.n_processed == 1
    known = Store(tmp_path / "store").load_flight(hashlib.sha256(first.read_bytes()).hexdigest())
    assert known
    for number in range(1, n_recordings):
        add_as_if_processed(tmp_path, number, known)
    assert run(tmp_path).counts.n_skipped == n_recordings  # which brings the index up to them
    n_seen = (tmp_path / "seen").stat().st_size
    started, started_cpu = time.monotonic(), time.process_time()
    counts = run(tmp_path).counts
    seconds, cpu_seconds = time.monotonic() - started, time.process_time() - started_cpu
    assert (counts.n_skipped, (tmp_path / "seen").stat().st_size) == (n_recordings, n_seen)
    print(f"{n_recordings} unchanged recordings: {seconds:.1f} s, of the processor {cpu_seconds:.1f} s")
    assert cpu_seconds < 10  # the other seconds are those of a busy machine


@pytest.mark.slow
def test_memory_and_open_files_do_not_grow(tmp_path: Path) -> None:
    """Of the batch and of its worker, over the second half of 2,000 flights."""
    rss_kib, n_files = [], []

    def measure() -> None:
        processes = [Path("/proc/self"), *_children()]
        rss_kib.append([_rss_kib(process) for process in processes])
        n_files.append([len(list((process / "fd").iterdir())) for process in processes])

    for number in range(2000):
        add_recording(tmp_path, number)
    run(tmp_path, measure)
    half = len(rss_kib) // 2
    slopes = np.polyfit(np.arange(half), np.array(rss_kib[-half:]), 1)[0]
    print(f"memory per flight, batch and worker: {slopes[0]:.2f} and {slopes[1]:.2f} KiB")
    assert (np.abs(slopes) < 4).all()
    assert np.ptp(np.array(n_files[half:]), axis=0).max() <= 2


def _children() -> list[Path]:
    pids = Path("/proc/thread-self/children").read_text(encoding="ascii").split()
    return [Path("/proc", pid) for pid in pids]


def _rss_kib(process: Path) -> int:
    (line,) = (row for row in (process / "status").read_text().splitlines() if row.startswith("VmRSS"))
    return int(line.split()[1])
