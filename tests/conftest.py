"""Fixtures that need something from outside the tree."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder of real data that is not part of the project."""
    folder = os.environ.get("LSNET_PIPE_DATA")
    if not folder:
        pytest.skip("LSNET_PIPE_DATA does not name the folder of shared material")
    return Path(folder) / "data"
