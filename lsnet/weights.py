"""Networks from weights files, and weights files from networks."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from safetensors import SafetensorError
from safetensors.torch import load as load_tensors
from safetensors.torch import save as save_tensors

from lsnet.errors import LSNetError
from lsnet.model import LSNet
from lsnet.weights_file import HEADER_KEY, LINE_SCORE_PREFIX, read_weights, unusable

if TYPE_CHECKING:
    from lsnet.lines.score import LineScore
    from lsnet.network_config import LSNetConfig
    from lsnet.weights_file import WeightsCard, WeightsFile


@dataclass(frozen=True, slots=True, eq=False)
class Weights:
    """A loaded network with its card and the sha256 of its file."""

    net: LSNet
    card: WeightsCard
    sha256: str


def save_weights(path: str | Path, net: LSNet, card: WeightsCard, line_score: LineScore | None = None) -> str:
    """Write a weights file, with the learned line score if there is one, and return its sha256.

    Raises:
        LSNetError: The file cannot be written.
    """
    tensors = {name: tensor.contiguous() for name, tensor in net.state_dict().items()}
    if line_score:
        tensors |= {name: torch.from_numpy(tensor) for name, tensor in line_score.tensors().items()}
    data = save_tensors(tensors, {HEADER_KEY: card.to_json()})
    try:
        Path(path).write_bytes(data)
    except OSError as err:
        raise LSNetError(f"{path}: cannot be written ({err.strerror}); name another file") from err
    return hashlib.sha256(data).hexdigest()


def load_weights(weights: str | Path) -> Weights:
    """Load weights by shipped name or file; every tensor must be present and fit.

    Raises:
        LSNetError: There are none of that name, or the file is damaged or of another version.
    """
    file = read_weights(weights)
    return Weights(load_network(file), file.card, file.sha256)


def load_network(file: WeightsFile) -> LSNet:
    """Return the network of a weights file, for inference. Raises LSNetError unless every tensor fits."""
    try:
        tensors = load_tensors(file.data)
        own = {name: tensor for name, tensor in tensors.items() if not name.startswith(LINE_SCORE_PREFIX)}
        return _network_of(file.card.network, own).eval()
    except (SafetensorError, ValueError, LookupError, ArithmeticError, TypeError, RuntimeError) as err:
        raise unusable(file.path, err) from err


def _network_of(config: LSNetConfig, tensors: dict[str, torch.Tensor]) -> LSNet:
    """Build a network around tensors; without memory of its own, since a card may describe a huge one."""
    with torch.device("meta"):
        net = LSNet(config)
    types = {name: tensor.dtype for name, tensor in net.state_dict().items()}
    copies = {name: tensor.to(types.get(name), copy=True) for name, tensor in tensors.items()}
    net.load_state_dict(copies, strict=True, assign=True)
    return net
