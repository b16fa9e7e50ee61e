"""Checkpoints in the folder of a run, `last.pt` and `best.pt`, and the weights that a run starts from."""

from __future__ import annotations

import hashlib
import os
from dataclasses import asdict
from pathlib import Path
from pickle import PickleError
from typing import TYPE_CHECKING, Any

import torch

from lsnet.errors import LSNetError
from lsnet.model import LSNet
from lsnet.network_config import LSNetConfig
from lsnet.training.pruning import slim
from lsnet.training.recipe import HOW_COMPUTED, TrainConfig
from lsnet.training.tasks import LSNetTask
from lsnet.weights import load_weights

if TYPE_CHECKING:
    from torch import Tensor, nn


BEST_KEYS = frozenset({"average", "step"})
LAST_KEYS = BEST_KEYS | {"recipe", "net", "optimizer", "best_loss", "bad_validations"}
# What torch raises for damaged files, depending on the place of the damage.
DAMAGE = (OSError, EOFError, PickleError, RuntimeError, ValueError, LookupError, TypeError, AttributeError)


def load_checkpoint(path: Path, keys: frozenset[str] = BEST_KEYS) -> dict[str, Any]:
    """Load `last.pt` (LAST_KEYS) or `best.pt`. Raises LSNetError when it is missing or damaged."""
    try:
        state: dict[str, Any] = torch.load(path, map_location="cpu", weights_only=True)
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


def read_start(start: str | Path, net: nn.Module) -> tuple[dict[str, Tensor], str]:
    """Read initial weights for a network; return them with the sha256 of their file.

    Args:
        start: The `best.pt` of a run, or weights as in `load_weights`, which may be of a wider LS-Net.
        net: The network that they must fit.

    Raises:
        LSNetError: They are missing, damaged, or of another network.
    """
    try:
        state, sha256 = _read_weights(start, net)
        shapes = {name: tensor.shape for name, tensor in net.state_dict().items()}
        fits = {name: tensor.shape for name, tensor in state.items()} == shapes
    except (ValueError, AttributeError):  # more than the widths differ, or no tensors
        fits = False
    if not fits:
        raise LSNetError(f"{start}: not weights of this network or a wider one; give such weights")
    return state, sha256


def _read_weights(start: str | Path, net: nn.Module) -> tuple[dict[str, Tensor], str]:
    path = Path(start)
    if path.suffix == ".pt":
        return load_checkpoint(path)["average"], hashlib.sha256(path.read_bytes()).hexdigest()
    weights = load_weights(start)
    wanted = net.config if isinstance(net, LSNet) else weights.card.network
    return slim(weights.net, wanted).state_dict(), weights.sha256


def other_options(kept: dict[str, Any], ours: dict[str, Any]) -> list[str]:
    """Return the options in which the recipe of a checkpoint differs from ours.

    Options that did not exist when it was written had the values that are the defaults today.
    """
    try:
        network = LSNetConfig(**kept["network"])
    except (LookupError, TypeError, ValueError):  # of another kind of network, or of none
        theirs = {"start_sha256": ours["start_sha256"]} | kept
    else:
        defaults = asdict(TrainConfig()) | LSNetTask(network).describe()
        theirs = defaults | {"start_sha256": ours["start_sha256"]} | kept | {"network": asdict(network)}
    return [name for name in ours if name not in HOW_COMPUTED and theirs.get(name) != ours[name]]
