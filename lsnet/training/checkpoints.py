"""What a run folder keeps of a training: `last.pt` and `best.pt`."""

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
# What torch raises on damage, by where in the file it is.
DAMAGE = (OSError, EOFError, PickleError, RuntimeError, ValueError, LookupError, TypeError, AttributeError)


def load_checkpoint(path: Path, keys: frozenset[str] = BEST_KEYS) -> dict[str, Any]:
    """What `last.pt` (LAST_KEYS) or `best.pt` holds. Raises LSNetError when it is missing or damaged."""
    try:
        state: dict[str, Any] = torch.load(path, weights_only=True)
    except DAMAGE as err:
        raise LSNetError(f"{path}: missing or damaged; give the checkpoint of a run") from err
    if not isinstance(state, dict) or not keys <= state.keys():
        raise LSNetError(f"{path}: not a checkpoint of a run; give one that model train has written")
    return state


def save_checkpoint(state: dict[str, Any], path: Path) -> None:
    """Write it beside and rename it, so that a kill leaves the old checkpoint or the new one.

    Raises LSNetError when it cannot be written.
    """
    partial = path.with_suffix(".partial")
    try:
        torch.save(state, partial)
        os.replace(partial, path)  # noqa: PTH105
    except (OSError, RuntimeError) as err:  # torch tells of a full disk by the latter
        raise LSNetError(f"{path}: cannot be written; make room, and run again to go on") from err
