"""`lsnet-pipe model ...` on tiny networks and few images."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import cv2
import numpy as np
from typer.testing import CliRunner

import cli
from lsnet.training import recipe

if TYPE_CHECKING:
    from pathlib import Path

    import pytest
    from click.testing import Result


TINY_RUN = ("--runtime", "torch", "--weights", "w.safetensors")


def run(*arguments: object) -> Result:
    """Run `lsnet-pipe model ...`."""
    return CliRunner().invoke(cli.app, ["model", *(str(word) for word in arguments)])


def photos(folder: Path, count: int = 2) -> Path:
    """Make a folder of images of random pixels."""
    folder.mkdir()
    for i in range(count):
        image = np.random.default_rng(i).integers(0, 256, (70, 100, 3), dtype=np.uint8)
        cv2.imwrite(str(folder / f"{i}.png"), image)
    return folder


def validate_on_few_images(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let trainings validate on two images."""
    for name, defaults in recipe.RECIPES.items():
        monkeypatch.setitem(recipe.RECIPES, name, replace(defaults, validation_images=2))
