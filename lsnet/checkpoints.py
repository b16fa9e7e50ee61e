"""What a run folder keeps of a training: `last.pt` and `best.pt`."""

from __future__ import annotations

import os
from pickle import UnpicklingError
from typing import TYPE_CHECKING, Any

import torch

from lsnet.errors import LSNetError

if TYPE_CHECKING:
    from pathlib import Path


def load_checkpoint(path: Path) -> dict[str, Any]:
    """What `last.pt` or `best.pt` holds. Raises LSNetError when it is missing or damaged."""
    try:
        state: dict[str, Any] = torch.load(path, weights_only=True)
    except (OSError, EOFError, RuntimeError, UnpicklingError) as err:
        raise LSNetError(f"{path}: missing or damaged; give the checkpoint of a run") from err
    return state


def save_checkpoint(state: dict[str, Any], path: Path) -> None:
    """Write it beside and rename it, so that a kill leaves the old checkpoint or the new one."""
    partial = path.with_suffix(".partial")
    torch.save(state, partial)
    os.replace(partial, path)  # noqa: PTH105
