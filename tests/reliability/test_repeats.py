"""Large inboxes: what is unchanged is not looked at again, and a long night takes no more memory."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from factories import Shot, make_recording
from stubs import MakeStub

from inspect_pipeline.batch import BatchOptions, run_batch
from inspect_pipeline.config import ProcessOptions
from inspect_pipeline.store import Store
from inspect_pipeline.worker import Job

if TYPE_CHECKING:
    from collections.abc import Callable

    from inspect_pipeline.runs import RunSummary

pytestmark = [pytest.mark.reliability, pytest.mark.timeout(7200)]


def run(folder: Path, n_recordings: int, on_done: Callable[[], object] = lambda: None) -> RunSummary:
    """A batch over recordings of one image each, which are made when they are missing."""
    inbox, store = folder / "inbox", Store(folder / "store")
    inbox.mkdir(exist_ok=True)
    for i in range(n_recordings):
        if not (inbox / f"r{i}.mcap").exists():
            make_recording(inbox / f"r{i}.mcap", [Shot(1, log_time_ns=10**18 + i)], n_gps_per_shot=0)

    def report(event: str, **fields: object) -> None:
        if event == "recording done":
            on_done()

    job = Job(store.root, ProcessOptions(), MakeStub(folder))
    return run_batch(store, job, BatchOptions((str(inbox),), settle_s=0), report)


@pytest.mark.parametrize("n_recordings", [40, pytest.param(10_000, marks=pytest.mark.slow)])
def test_an_unchanged_inbox(tmp_path: Path, n_recordings: int) -> None:
    assert run(tmp_path, n_recordings).counts.n_processed == n_recordings
    n_seen = (tmp_path / "seen").stat().st_size
    started, started_cpu = time.monotonic(), time.process_time()
    counts = run(tmp_path, n_recordings).counts
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

    run(tmp_path, 2000, measure)
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
