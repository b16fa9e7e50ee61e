"""Presets of tiny networks, and a run that is done."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
import torch
from nets import TINY
from training_runs import QUICK, THIN, Strokes, quiet

from lsnet import network_config
from lsnet.training.trainer import Trainer


@pytest.fixture(autouse=True)
def _tiny_preset(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(network_config.PRESETS, "tiny", TINY)
    monkeypatch.setitem(network_config.PRESETS, "thin", THIN)


@pytest.fixture(scope="session")
def template(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run that is done, to be copied."""
    folder = tmp_path_factory.mktemp("finished") / "run"
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(network_config.PRESETS, "tiny", TINY)
        Trainer(QUICK, folder).run(Strokes(), Strokes(), quiet)
    return folder


@pytest.fixture
def finished(template: Path, tmp_path: Path) -> Path:
    """The folder of a run that is done."""
    return Path(shutil.copytree(template, tmp_path / "a"))


@pytest.fixture(autouse=True)
def _threads_restored() -> object:
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)
