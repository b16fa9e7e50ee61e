"""Tiny weights, w.safetensors, in a folder of their own."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
import torch
from nets import TINY, save_tiny

from lsnet import network_config

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    threads = torch.get_num_threads()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(network_config.PRESETS, "tiny", TINY)
    save_tiny(tmp_path / "w.safetensors", min_score=0.4)
    yield
    torch.set_num_threads(threads)
