"""Fixtures that several files share."""

from __future__ import annotations

import atexit
import functools
import gc
import os
import shutil
from pathlib import Path
from typing import TYPE_CHECKING

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before NumPy and torch: pytest-xdist has a worker a core

import cv2
import numpy as np
import pytest
import typer.main
import typer.testing

from inspect_pipeline.simulation import ground as simulate_ground
from inspect_pipeline.simulation import write as simulate

if TYPE_CHECKING:
    from collections.abc import Iterator

cv2.setNumThreads(1)
gc.disable()  # until all tests are imported
atexit.register(gc.unfreeze)  # or DuckDB's bindings report objects that were not freed


def pytest_configure(config: pytest.Config) -> None:
    """Let the fast tests write to memory: a disk takes long to sync and to remove thousands of files."""
    memory = Path("/dev/shm")  # noqa: S108
    is_fast = "not slow and not reliability" in config.option.markexpr
    if is_fast and memory.is_dir() and shutil.disk_usage(memory).free > 2 << 30:
        os.environ.setdefault("PYTEST_DEBUG_TEMPROOT", str(memory))


def pytest_collection_finish() -> None:
    """Keep imported objects out of garbage collections."""
    gc.freeze()
    gc.enable()


@pytest.fixture(scope="session", autouse=True)
def _commands_made_once() -> Iterator[None]:
    """Typer builds all commands of the program whenever one is run, which takes longer than most tests."""
    made_once = functools.cache(typer.main.get_command)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(typer.main, "get_command", made_once)
        patch.setattr(typer.testing, "_get_command", made_once)
        yield


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder of real data that is not part of the project."""
    folder = os.environ.get("LSNET_PIPE_DATA")
    if not folder:
        pytest.skip("LSNET_PIPE_DATA does not name the folder of shared material")
    return Path(folder) / "data"


@pytest.fixture(scope="module")
def flat_ground() -> Iterator[None]:
    """Simulate flights over plain ground, which takes no time to draw."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            simulate, "draw_ground", lambda rng: np.full((*simulate_ground.TILE_TEXELS, 3), 90, np.uint8)
        )
        yield


@pytest.fixture(scope="module")
def small_ground() -> Iterator[None]:
    """Use a quarter of the drawn ground of simulated flights, which repeats."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(simulate_ground, "TILE_TEXELS", (512, 2048))
        yield


@pytest.fixture
def bare_flights(monkeypatch: pytest.MonkeyPatch) -> None:
    """Publish without pictures and files for viewers, which take longer than small flights do."""
    monkeypatch.setattr("inspect_pipeline.publishing._makers", tuple)
