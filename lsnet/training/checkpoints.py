"""Checkpoints in the folder of a run: `last.pt` and `best.pt`."""

from __future__ import annotations

import os
from pickle import PickleError
from typing import TYPE_CHECKING, Any

import torch

from lsnet.errors import LSNetError

if TYPE_CHECKING:
    from pathlib import Path


BEST_KEYS = frozenset({"average", "step"})
LAST_KEYS = BEST_KEYS | {"recipe", "net", "optimizer", "best_loss", "bad_validations"}
# What torch raises for damaged files, depending on the place of the damage.
DAMAGE = (OSError, EOFError, PickleError, RuntimeError, ValueError, LookupError, TypeError, AttributeError)


def load_checkpoint(path: Path, keys: frozenset[str] = BEST_KEYS) -> dict[str, Any]:
    """Load `last.pt` (LAST_KEYS) or `best.pt`. Raises LSNetError when it is missing or damaged."""
    try:
        state: dict[str, Any] = torch.load(path, weights_only=True)
    except DAMAGE as err:
        raise LSNetError(f"{path}: missing or damaged; give the checkpoint of a run") from err
    if not isinstance(state, dict) or not keys <= state.keys():
        raise LSNetError(f"{path}: not a checkpoint of a run; give one written by training")
    return state


def save_checkpoint(state: dict[str, Any], path: Path) -> None:
    """Write a checkpoint to a temporary name and rename it, so that a kill leaves the old one or the new one.

    Raises:
        LSNetError: It cannot be written.
    """
    partial = path.with_suffix(".partial")
    try:
        torch.save(state, partial)
        os.replace(partial, path)  # noqa: PTH105
    except (OSError, RuntimeError) as err:  # torch raises RuntimeError for a full disk
        raise LSNetError(f"{path}: cannot be written; free disk space, and run again to continue") from err
