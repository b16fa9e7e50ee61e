"""Crashes: whatever step a process dies at, each flight is there whole, and the next run cleans up."""

from __future__ import annotations

import errno
import os
import shutil
import signal
import sys
from itertools import count
from typing import TYPE_CHECKING, Any

import flights
import pytest
from flights import versions, versions_in_index
from stores import disk_state, where_states_change

from inspect_pipeline import atomic as files
from inspect_pipeline.errors import StoreError
from inspect_pipeline.index import publish as index
from inspect_pipeline.store.store import Store

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

SYSTEM_CALLS = {"mkdir", "open", "write", "fsync", "rename", "replace", "unlink", "rmdir", "close"}


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(tmp_path / "inspections")


@pytest.mark.parametrize("has_exchange", [True, False])
def test_no_space_at_any_fsync(store: Store, monkeypatch: pytest.MonkeyPatch, has_exchange: bool) -> None:
    if not has_exchange:
        monkeypatch.setattr(files, "_exchange", _no_exchange)
    flight_id = flights.write_flight(store, "a", 3)
    calls, failing, fsync = 0, 0, os.fsync

    def fsync_once_full(descriptor: int) -> None:
        nonlocal calls
        calls += 1
        if calls == failing:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", fsync_once_full)
    while True:
        calls, failing = 0, failing + 1
        try:
            flights.write_flight(store, "a", 2)
        except StoreError as error:
            assert "no space" in str(error)  # noqa: PT017
        else:
            break
        assert versions(store)["a"] in (2, 3)
        assert [p.name for p in (store.root / "staging").iterdir()] == ["mutex"]
    assert failing > 5
    loaded = store.load_flight(flight_id)
    assert loaded is not None
    assert loaded.totals.n_frames == 2


@pytest.mark.reliability
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("has_exchange", [True, False])
def test_killed_at_some_steps(store: Store, tmp_path: Path, has_exchange: bool) -> None:
    _kill_at_steps(store, tmp_path, 29, has_exchange=has_exchange)


@pytest.mark.reliability
@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("has_exchange", [True, False])
def test_killed_at_every_step(store: Store, tmp_path: Path, has_exchange: bool) -> None:
    names = _kill_at_steps(store, tmp_path, 1, has_exchange=has_exchange)
    assert {"mkdir", "fsync", "rename", "replace", "unlink", "commit", "_insert_flights", "_flush"} <= names


def test_a_killed_move_aside_is_undone_by_a_publish(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    flight_id = flights.write_flight(store, "a", 2)
    folder = store.flight_dir(flight_id)
    staging = store.root / "staging" / f"{folder.name}-00000000"
    folder.rename(staging.with_name(f"{staging.name}.previous"))
    staging.with_name(f"{staging.name}.lock").touch()
    index.publish(store)
    assert versions(store) == versions_in_index(store) == {"a": 2}
    assert [p.name for p in (store.root / "staging").iterdir()] == ["mutex"]


def _kill_at_steps(store: Store, tmp_path: Path, stride: int, *, has_exchange: bool) -> set[str]:
    """Replace a flight, add another and publish, with SIGKILL at every `stride`-th step; the steps' names.

    Steps between which the store is the same, byte for byte, count as one; its first and its last are tried.
    """
    flights.write_flight(store, "a", 2)
    index.publish(store)
    steps = _record_steps(store, tmp_path / "undisturbed", has_exchange=has_exchange)
    for number in where_states_change([state for state, _ in steps])[::stride]:
        killed = Store(tmp_path / f"killed-{number}")
        shutil.copytree(store.root, killed.root)
        counted = count(1)

        def kill(_: str, killed_at: int = number + 1, counted: count[int] = counted) -> None:
            if next(counted) == killed_at:
                os.kill(os.getpid(), signal.SIGKILL)

        status = _run_watched(killed, kill, has_exchange=has_exchange)
        assert os.WIFSIGNALED(status), f"not killed at step {number} of {len(steps)}"
        found = versions(killed)
        assert set(found.values()) <= {2, 3}
        assert "a" in found or not has_exchange
        assert versions_in_index(killed) in ({"a": 2}, {"a": 3, "b": 3})
        _replace_and_add(killed)
        assert versions(killed) == versions_in_index(killed) == {"a": 3, "b": 3}
        assert [p.name for p in (killed.root / "staging").iterdir()] == ["mutex"]
        assert not list(killed.root.glob("index.duckdb?*"))
        shutil.rmtree(killed.root)
    return {name for _, name in steps}


def _record_steps(store: Store, root: Path, *, has_exchange: bool) -> list[tuple[str, str]]:
    """The state of a copy of the store in `root` before each step, and the step's name."""
    copy = Store(root)
    shutil.copytree(store.root, copy.root)
    log = root.with_name("steps")
    with log.open("ab", buffering=0) as file:
        status = _run_watched(
            copy,
            lambda name: file.write(f"{disk_state(copy)} {name}\n".encode()),
            has_exchange=has_exchange,
        )
    assert status == 0
    lines = [line.split() for line in log.read_text().splitlines()]
    return [(state, name) for state, name in lines]


def _replace_and_add(store: Store) -> None:
    flights.write_flight(store, "a", 3)
    flights.write_flight(store, "b", 3)
    index.publish(store)


def _run_watched(store: Store, on_step: Callable[[str], object], *, has_exchange: bool) -> int:
    """Return how a child ended that reported its steps, ours or the system's, before each."""
    child = os.fork()
    if child == 0:
        if not has_exchange:
            files._exchange = _no_exchange
        sys.setprofile(_watcher(on_step))
        try:
            _replace_and_add(store)
        finally:
            os._exit(0)
    return os.waitpid(child, 0)[1]


def _watcher(on_step: Callable[[str], object]) -> Callable[[Any, str, Any], None]:
    def profile(frame: Any, event: str, function: Any) -> None:
        code = frame.f_code
        is_ours = event == "call" and "inspect_pipeline" in code.co_filename
        if is_ours or (event == "c_call" and function.__name__ in SYSTEM_CALLS):
            on_step(code.co_name if is_ours else function.__name__)

    return profile


def _no_exchange(first: Path, second: Path) -> None:
    raise OSError(errno.EINVAL, os.strerror(errno.EINVAL))
