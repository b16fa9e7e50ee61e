"""Crashes: whatever step a process dies at, each flight is there whole, and the next run cleans up."""

from __future__ import annotations

import errno
import os
import shutil
import signal
import sys
from functools import partial
from typing import TYPE_CHECKING, Any

import flights
import pytest
from flights import versions, versions_in_index

from inspect_pipeline import files, index
from inspect_pipeline.errors import StoreError
from inspect_pipeline.store import Store

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


@pytest.mark.parametrize("has_exchange", [True, False])
def test_killed_at_some_steps(store: Store, tmp_path: Path, has_exchange: bool) -> None:
    _kill_at_steps(store, tmp_path, 151, has_exchange=has_exchange)


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("has_exchange", [True, False])
def test_killed_at_every_step(store: Store, tmp_path: Path, has_exchange: bool) -> None:
    names = _kill_at_steps(store, tmp_path, 1, has_exchange=has_exchange)
    assert {"mkdir", "fsync", "rename", "replace", "unlink", "commit", "_insert_flights", "_flush"} <= set(
        names
    )


def test_a_killed_move_aside_is_undone_by_a_publish(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    flight_id = flights.write_flight(store, "a", 2)
    folder = store.flight_dir(flight_id)
    staging = store.root / "staging" / f"{folder.name}-00000000"
    folder.rename(staging.with_name(f"{staging.name}.previous"))
    staging.with_name(f"{staging.name}.lock").touch()
    index.publish(store)
    assert versions(store) == versions_in_index(store) == {"a": 2}
    assert [p.name for p in (store.root / "staging").iterdir()] == ["mutex"]


def _kill_at_steps(store: Store, tmp_path: Path, stride: int, *, has_exchange: bool) -> list[str]:
    """Replace a flight, add another and publish, with SIGKILL at every `stride`-th step; the steps' names."""
    flights.write_flight(store, "a", 2)
    index.publish(store)
    names: list[str] = []
    for number in range(0, 10_000, stride):
        killed = Store(tmp_path / f"killed-{number}")
        shutil.copytree(store.root, killed.root)
        name = _run_until_step(partial(_replace_and_add, killed), number, has_exchange=has_exchange)
        found = versions(killed)
        assert set(found.values()) <= {2, 3}
        assert "a" in found or not has_exchange
        assert versions_in_index(killed) in ({"a": 2}, {"a": 3, "b": 3})
        _replace_and_add(killed)
        assert versions(killed) == versions_in_index(killed) == {"a": 3, "b": 3}
        assert [p.name for p in (killed.root / "staging").iterdir()] == ["mutex"]
        assert not list(killed.root.glob("index.duckdb?*"))
        shutil.rmtree(killed.root)
        if name is None:
            return names
        names.append(name)
    raise AssertionError("it never ends")


def _replace_and_add(store: Store) -> None:
    flights.write_flight(store, "a", 3)
    flights.write_flight(store, "b", 3)
    index.publish(store)


def _run_until_step(action: Callable[[], None], number: int, *, has_exchange: bool) -> str | None:
    """Run in a child that is killed before step `number`, ours or the system's; its name, or None."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        if not has_exchange:
            files._exchange = _no_exchange
        sys.setprofile(_killer(number, writer))
        try:
            action()
        finally:
            os._exit(0)
    os.close(writer)
    with os.fdopen(reader, "rb") as pipe:
        name = pipe.read().decode()
    _, status = os.waitpid(child, 0)
    assert os.WIFSIGNALED(status) == bool(name)
    return name or None


def _killer(number: int, writer: int) -> Callable[[Any, str, Any], None]:
    count = 0

    def profile(frame: Any, event: str, function: Any) -> None:
        nonlocal count
        code = frame.f_code
        is_ours = event == "call" and "inspect_pipeline" in code.co_filename
        if is_ours or (event == "c_call" and function.__name__ in SYSTEM_CALLS):
            if count == number:
                name = code.co_name if is_ours else function.__name__
                os.write(writer, name.encode())
                os.kill(os.getpid(), signal.SIGKILL)
            count += 1

    return profile


def _no_exchange(first: Path, second: Path) -> None:
    raise OSError(errno.EINVAL, os.strerror(errno.EINVAL))
