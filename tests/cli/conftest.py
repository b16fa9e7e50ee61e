"""Commands with a fake detector, in a folder of their own, where one recording may be processed already."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING

import pytest
from command_line import Outcome, runner
from factories import make_recording, shots
from fakes import FakeDetector
from inline_queries import answer_here

import lsnet

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


@pytest.fixture
def run(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], tmp_path: Path, bare_flights: None
) -> Callable[..., Outcome]:
    """Run `lsnet-pipe ...` in this process, with a fake detector, in a folder of its own."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("LSNET_PIPE_STORE", str(tmp_path / "store"))
    monkeypatch.setattr(lsnet, "Detector", FakeDetector)
    answer_here(monkeypatch)
    return runner(monkeypatch, capfd)


@pytest.fixture(scope="session")
def processed_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of three frames and its store, with everything that is derived."""
    from inspect_pipeline.pipeline import process  # noqa: PLC0415 - torch
    from inspect_pipeline.publishing import publish  # noqa: PLC0415

    folder = tmp_path_factory.mktemp("processed")
    process(make_recording(folder / "a.mcap", shots(3)), folder / "store", FakeDetector())
    publish(folder / "store")
    return folder


@pytest.fixture
def flight(run: Callable[..., Outcome], processed_folder: Path, tmp_path: Path) -> str:
    """The id of the flight of a.mcap, which is processed."""
    shutil.copy(processed_folder / "a.mcap", tmp_path)
    shutil.copytree(processed_folder / "store", tmp_path / "store")
    return run("query", "SELECT flight_id FROM flights", "--format", "csv").out.split()[1]
