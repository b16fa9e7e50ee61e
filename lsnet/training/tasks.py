"""What is trained: a network, the targets that it learns from samples, and its loss."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

import torch

from lsnet.errors import LSNetError
from lsnet.grid import OFF_CENTRE_PENALTY, GridCoder
from lsnet.model import LSNet
from lsnet.network_config import PRESETS, LSNetConfig
from lsnet.training.losses import MultiTaskLoss
from lsnet.training.options import with_options

if TYPE_CHECKING:
    from collections.abc import Iterable

    from torch import Tensor, nn

    from lsnet.model import RawOutput
    from lsnet.synth.drawing import Sample
    from lsnet.training.losses import LossSums


class Task(Protocol):
    """One network to train."""

    def build(self) -> nn.Module:
        """Return the network with initial weights: images (N, 3, H, W) in [0, 1] to its output."""
        ...

    def encode(self, sample: Sample) -> tuple[Tensor, ...]:
        """Return the targets of one sample."""
        ...

    def sums(self, output: Any, *targets: Tensor) -> LossSums:
        """Return the sums of the losses of a batch."""
        ...

    def describe(self) -> dict[str, Any]:
        """Return the network, the loss and their options in plain values, for checkpoints."""
        ...


@dataclass(frozen=True, slots=True)
class LSNetTask:
    """LS-Net on its four grids.

    Attributes:
        network: The network.
        loss: Its loss.
        off_centre_penalty: As in `GridCoder`; 0 for strictly the longest segment of a cell, as in the paper.
    """

    network: LSNetConfig = PRESETS["fast"]
    loss: MultiTaskLoss = field(default_factory=MultiTaskLoss)
    off_centre_penalty: float = OFF_CENTRE_PENALTY

    def build(self) -> LSNet:
        """Return the network with initial weights."""
        return LSNet(self.network)

    def encode(self, sample: Sample) -> tuple[Tensor, ...]:
        """Return labels (R, C) and endpoints (R, C, 4) as in `grid.Targets`."""
        height, width = sample.image.shape[:2]
        coder = GridCoder(off_centre_penalty=self.off_centre_penalty)
        targets = coder.encode(sample.lines, (height, width))
        return torch.from_numpy(targets.labels), torch.from_numpy(targets.endpoints)

    def sums(self, output: RawOutput, *targets: Tensor) -> LossSums:
        """Return the sums of the losses of a batch."""
        labels, endpoints = targets
        return self.loss.sums(output, labels, endpoints)

    def describe(self) -> dict[str, Any]:
        """Return network, loss and choice of chords in plain values."""
        return asdict(self)


def open_task(
    preset: str, network: Iterable[str] = (), loss: Iterable[str] = (), *, longest: bool = False
) -> LSNetTask:
    """Return LS-Net of a preset with options as NAME=VALUE; `longest` for strictly the longest segments.

    Raises:
        LSNetError: The preset or an option is unknown.
    """
    if preset not in PRESETS:
        raise LSNetError(f"no preset {preset!r}; choose one of {', '.join(PRESETS)}")
    return LSNetTask(
        with_options(PRESETS[preset], network),
        with_options(MultiTaskLoss(), loss),
        0.0 if longest else OFF_CENTRE_PENALTY,
    )
