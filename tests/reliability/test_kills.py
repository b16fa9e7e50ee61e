"""Batches that are killed at random moments: nothing partial, nothing lost, nothing twice."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import duckdb
import pytest
from factories import make_recording, shots
from flights import versions, versions_in_index

from inspect_pipeline.store import Store

pytestmark = [pytest.mark.reliability, pytest.mark.timeout(600)]
N_RECORDINGS = 12
DRIVER = Path(__file__).with_name("driver.py")
# What differs between two runs over the same recordings, by nature.
NOT_COMPARED = "EXCLUDE (run_id, ingested_at, result_sha256)"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "inbox").mkdir()
    for i in range(N_RECORDINGS):
        make_recording(tmp_path / "inbox" / f"r{i}.mcap", shots(4 + i))
    return tmp_path


def start(folder: Path, store: str, weights: str, delay_s: float = 0.0) -> subprocess.Popen[bytes]:
    environment = {**os.environ, "PYTHONPATH": str(DRIVER.parents[1])}
    arguments = [folder / "inbox", folder / store, folder, weights, delay_s]
    return subprocess.Popen([sys.executable, DRIVER, *map(str, arguments)], env=environment)


def workers_of(driver: subprocess.Popen[bytes]) -> list[int]:
    try:
        return [
            int(pid) for pid in Path(f"/proc/{driver.pid}/task/{driver.pid}/children").read_text().split()
        ]
    except FileNotFoundError:
        return []


def wait_for(condition: Any, timeout_s: float = 60.0) -> None:
    deadline = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def disturb(driver: subprocess.Popen[bytes], dice: random.Random) -> str:
    """Kill the driver, or a worker and later the driver, at a random moment of its work; who was killed."""
    wait_for(lambda: driver.poll() is not None or len(workers_of(driver)) > 0)
    time.sleep(dice.uniform(0, 3))
    victim = "driver"
    if dice.random() < 0.5 and (workers := workers_of(driver)):
        victim = "worker"
        os.kill(dice.choice(workers), signal.SIGKILL)
        time.sleep(dice.uniform(0, 2))
    orphans = workers_of(driver)
    driver.kill()
    driver.wait()
    wait_for(lambda: not any(Path(f"/proc/{pid}").exists() for pid in orphans), 5)
    return victim


def check_visible(store: Store) -> None:
    """Whatever can be seen is whole, and there once."""
    if (store.root / "flights").exists():
        versions(store)
    if store.index_path.exists():
        versions_in_index(store)
        with duckdb.connect(store.index_path, read_only=True) as connection:
            twice = "SELECT 1 FROM frames GROUP BY flight_id, channel_id, frame_idx HAVING count(*) > 1"
            assert connection.execute(twice).fetchall() == []
    assert not (store.root / "quarantine").exists()


def contents(store: Store) -> dict[str, list[tuple[Any, ...]]]:
    with duckdb.connect(store.index_path, read_only=True) as connection:
        selections = {
            "flights": NOT_COMPARED,
            "channels": "",
            "frames": "EXCLUDE (infer_ms)",
            "segments": "",
            "lines": "",
        }
        return {
            table: connection.execute(f"SELECT * {how} FROM {table} ORDER BY ALL").fetchall()
            for table, how in selections.items()
        }


def files(store: Store) -> set[str]:
    """The files of a store but those named after runs, and without the log."""
    found = {path.relative_to(store.root).as_posix() for path in store.root.rglob("*") if path.is_file()}
    return {name for name in found if not name.startswith("runs/")}


@pytest.mark.parametrize(
    "seed", [*range(5), *(pytest.param(i, marks=pytest.mark.slow) for i in range(5, 100))]
)
def test_killed_at_random_points(folder: Path, seed: int) -> None:
    """Five rounds with other weights each, so that every flight is to be replaced again."""
    dice, victims = random.Random(seed), []  # noqa: S311 - a dice
    store = Store(folder / "disturbed")
    for i in range(5):
        victims.append(disturb(start(folder, "disturbed", f"round {i}", 0.05), dice))
        check_visible(store)
    assert start(folder, "disturbed", "last").wait() == 0
    assert start(folder, "undisturbed", "last").wait() == 0
    check_visible(store)
    undisturbed = Store(folder / "undisturbed")
    assert contents(store) == contents(undisturbed)
    assert files(store) == files(undisturbed)
    assert len(versions(store)) == len(versions_in_index(store)) == N_RECORDINGS
    print(f"{victims.count('driver')} kills of a driver, {victims.count('worker')} of a worker and a driver")


def test_killed_workers_cost_nothing(folder: Path) -> None:
    dice, n_kills = random.Random(5), 0  # noqa: S311 - a dice
    driver = start(folder, "store", "fast", 0.2)
    while driver.poll() is None and n_kills < 5:
        wait_for(lambda: driver.poll() is not None or len(workers_of(driver)) > 0)
        time.sleep(dice.uniform(0.5, 1.5))
        for pid in workers_of(driver)[:1]:
            os.kill(pid, signal.SIGKILL)
            n_kills += 1
    assert driver.wait(120) == 0
    assert n_kills > 0
    check_visible(Store(folder / "store"))
    assert len(versions_in_index(Store(folder / "store"))) == N_RECORDINGS


def test_two_batches_at_once(folder: Path) -> None:
    """The second one is away within a second of processor time, names the first, and harms nothing."""
    first = start(folder, "store", "fast", 1.0)
    wait_for(lambda: len(workers_of(first)) > 0)
    command = [sys.executable, "-m", "cli", "batch", folder / "inbox", "--store", folder / "store"]
    before = os.times()
    second = subprocess.run(command, capture_output=True, text=True, check=False)
    after = os.times()
    assert second.returncode == 11
    assert f"pid {first.pid} since" in second.stderr
    assert after.children_user + after.children_system - before.children_user - before.children_system < 1
    assert first.wait(120) == 0
    assert len(versions_in_index(Store(folder / "store"))) == N_RECORDINGS


@pytest.mark.parametrize(("number", "exit_code"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)])
def test_stopped_and_resumed(folder: Path, number: signal.Signals, exit_code: int) -> None:
    store = Store(folder / "store")
    driver = start(folder, "store", "fast", 0.3)
    wait_for(lambda: len(list(store.root.glob("flights/*"))) >= 2)
    driver.send_signal(number)
    assert driver.wait(20) == exit_code
    assert [path.name for path in (store.root / "staging").iterdir()] == ["mutex"]
    n_done = len(versions_in_index(store))
    assert 2 <= n_done < N_RECORDINGS
    assert json.loads((store.root / "summary.json").read_text())["counts"]["n_left"] == N_RECORDINGS - n_done
    done, n_seen = versions(store), (folder / "seen").stat().st_size
    assert start(folder, "store", "fast").wait(120) == 0
    n_left = sum(versions_in_index(store).values()) - sum(done.values())
    assert (folder / "seen").stat().st_size - n_seen == n_left  # what was done was not done again
    assert len(versions(store)) == N_RECORDINGS
