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
from typing import TYPE_CHECKING, Any

import driver
import pytest
from factories import make_recording, shots
from flights import versions, versions_in_index
from stores import check_visible, contents, file_names
from stubs import LIGHT

from inspect_pipeline.store.store import Store

if TYPE_CHECKING:
    from collections.abc import Callable

    Batch = subprocess.Popen[bytes] | driver.Fork

pytestmark = [pytest.mark.reliability, pytest.mark.timeout(1800)]
N_RECORDINGS = 12
LAST = "last"  # weights that no killed batch has


@pytest.fixture(scope="module")
def inbox(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("inbox")
    for i in range(N_RECORDINGS):
        make_recording(folder / f"r{i}.mcap", shots(4 + i))
    return folder


@pytest.fixture(scope="module")
def undisturbed(inbox: Path, tmp_path_factory: pytest.TempPathFactory) -> Store:
    """A store after one batch that nobody killed."""
    store = Store(tmp_path_factory.mktemp("undisturbed") / "store")
    assert start(inbox, store, LAST).wait() == 0
    return store


def start(inbox: Path, store: Store, weights: str, delay_s: float = 0.0) -> subprocess.Popen[bytes]:
    """A batch; the notes of its stub lie beside the store."""
    folders = [LIGHT, LIGHT.parent, LIGHT.parents[2]]
    return subprocess.Popen(
        [sys.executable, driver.__file__, *_arguments(inbox, store, weights, delay_s)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(map(str, folders))},
    )


def fork(inbox: Path, store: Store, weights: str, delay_s: float = 0.0) -> driver.Fork:
    """The same without the seconds that interpreters take to start."""
    return driver.start_forked(_arguments(inbox, store, weights, delay_s))


def _arguments(inbox: Path, store: Store, weights: str, delay_s: float) -> list[str]:
    return [str(inbox), str(store.root), str(store.root.parent), weights, str(delay_s)]


def workers_of(batch: Batch) -> list[int]:
    try:
        return [int(pid) for pid in Path(f"/proc/{batch.pid}/task/{batch.pid}/children").read_text().split()]
    except FileNotFoundError:
        return []


def loaded_workers(batch: Batch, store: Store) -> list[int]:
    """Those that have their detector: what is killed before counts as a worker that cannot start."""
    notes = store.root.parent / "workers"
    loaded = notes.read_text().split() if notes.exists() else []
    return [pid for pid in workers_of(batch) if str(pid) in loaded]


def wait_for(condition: Any, timeout_s: float = 600.0) -> None:
    deadline = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def disturb(batch: Batch, store: Store, dice: random.Random) -> list[str]:
    """Kill the driver, or a worker and later the driver, at a random moment of its work; who was killed.

    The moment is a while after a number of flights: from none, when workers start, to all, when the index is
    published. So it does not depend on how fast the machine is.
    """
    wait_for(lambda: batch.poll() is not None or len(workers_of(batch)) > 0)
    wanted = n_written(store) + dice.randint(0, N_RECORDINGS)
    wait_for(lambda: batch.poll() is not None or n_written(store) >= wanted)
    time.sleep(dice.uniform(0, 0.5))
    victims = []
    if dice.random() < 0.5 and (workers := workers_of(batch)):
        os.kill(dice.choice(workers), signal.SIGKILL)
        victims.append("worker")
        time.sleep(dice.uniform(0, 2))
    orphans = workers_of(batch)
    if batch.poll() is None:
        batch.kill()
        victims.append("driver")
    batch.wait()
    wait_for(lambda: not any(Path(f"/proc/{pid}").exists() for pid in orphans))
    return victims


def n_written(store: Store) -> int:
    """How many flights were ever committed."""
    manifest = store.root / "manifest.jsonl"
    return manifest.read_text().count('"event": "flight"') if manifest.exists() else 0


@pytest.mark.parametrize(
    ("begin", "seed", "n_rounds"),
    [
        *((start, i, 5) for i in range(4)),
        *(pytest.param(fork, i, 10, marks=pytest.mark.slow) for i in range(4, 52)),
    ],
)
def test_killed_at_random_points(
    inbox: Path, undisturbed: Store, tmp_path: Path, begin: Callable[..., Batch], seed: int, n_rounds: int
) -> None:
    """Rounds with other weights each, so that every flight is to be replaced again."""
    dice, victims = random.Random(seed), []  # noqa: S311 - a dice
    store = Store(tmp_path / "store")
    for i in range(n_rounds):
        victims += disturb(begin(inbox, store, f"round {i}", 0.05), store, dice)
        check_visible(store)
    assert begin(inbox, store, LAST).wait() == 0
    check_visible(store)
    assert contents(store) == contents(undisturbed)
    assert file_names(store) == file_names(undisturbed)
    assert len(versions(store)) == len(versions_in_index(store)) == N_RECORDINGS
    print(f"{victims.count('driver')} drivers and {victims.count('worker')} workers killed")


def test_killed_workers_cost_nothing(inbox: Path, tmp_path: Path) -> None:
    dice, n_kills = random.Random(5), 0  # noqa: S311 - a dice
    store = Store(tmp_path / "store")
    batch = start(inbox, store, "fast", 0.2)
    while batch.poll() is None and n_kills < 5:
        wait_for(lambda: batch.poll() is not None or len(loaded_workers(batch, store)) > 0)
        time.sleep(dice.uniform(0.2, 1.2))
        for pid in loaded_workers(batch, store)[:1]:
            os.kill(pid, signal.SIGKILL)
            n_kills += 1
    assert batch.wait(120) == 0
    assert n_kills > 0
    check_visible(store)
    assert len(versions_in_index(store)) == N_RECORDINGS


def test_two_batches_at_once(inbox: Path, tmp_path: Path) -> None:
    """The second one is away within a second of processor time, names the first, and harms nothing."""
    store = Store(tmp_path / "store")
    first = start(inbox, store, "fast", 1.0)
    wait_for(lambda: len(workers_of(first)) > 0)
    command = [sys.executable, "-m", "cli", "batch", inbox, "--store", store.root]
    before, started = os.times(), time.monotonic()
    second = subprocess.run(command, capture_output=True, text=True, check=False)
    after, seconds = os.times(), time.monotonic() - started
    cpu_seconds = after.children_user + after.children_system - before.children_user - before.children_system
    print(f"the second batch was away after {seconds:.2f} s, of the processor {cpu_seconds:.2f} s")
    assert second.returncode == 11
    assert f"pid {first.pid} since" in second.stderr
    assert cpu_seconds < 1  # the other seconds are those of a busy machine
    assert first.wait(120) == 0
    assert len(versions_in_index(store)) == N_RECORDINGS


@pytest.mark.parametrize(("number", "exit_code"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)])
def test_stopped_and_resumed(inbox: Path, tmp_path: Path, number: signal.Signals, exit_code: int) -> None:
    store = Store(tmp_path / "store")
    batch = start(inbox, store, "fast", 0.3)
    wait_for(lambda: len(list(store.root.glob("flights/*"))) >= 2)
    batch.send_signal(number)
    assert batch.wait(20) == exit_code
    assert [path.name for path in (store.root / "staging").iterdir()] == ["mutex"]
    n_done = len(versions_in_index(store))
    assert 2 <= n_done < N_RECORDINGS
    assert json.loads((store.root / "summary.json").read_text())["counts"]["n_left"] == N_RECORDINGS - n_done
    done, n_seen = versions(store), (tmp_path / "seen").stat().st_size
    assert start(inbox, store, "fast").wait(120) == 0
    n_left = sum(versions_in_index(store).values()) - sum(done.values())
    assert (tmp_path / "seen").stat().st_size - n_seen == n_left  # what was done was not done again
    assert len(versions(store)) == N_RECORDINGS
