"""WSL-CNN (Lee et al., 2017), a rival trained on whether a window of 128 px has a line, not where.

    window 128 x 128
    2 x Conv3-64, pool, 2 x Conv3-128, pool, 4 x Conv3-256, pool, 4 x Conv3-512, pool, 4 x Conv3-512, pool
    Conv4-512, Conv1-2

This is VGG-19 with its fully connected layers as a convolution over the 4 x 4 positions of a window, so that
one pass classifies all windows 32 px apart. The LS-Net paper prints neither its layers nor the windows' step:
assumed are VGG-19's own layers, GroupNorm (training starts from scratch here, theirs from ImageNet), a step
of 32 px, and for the localization the last feature maps of the first three blocks, each averaged over its
channels.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import nn

from lsnet.evaluation.baselines.wd_dcnn import drawn_lines, of_pixels
from lsnet.model import ConvNormAct

if TYPE_CHECKING:
    from torch import Tensor

    from lsnet.synth.drawing import Sample
    from lsnet.training.losses import LossSums

WINDOW_PX, STEP_PX = 128, 32
CONVOLUTIONS = (2, 2, 4, 4, 4)  # per block of VGG-19
LOCALIZED_BLOCKS = 3  # whose feature maps are combined: of 1, 1/2 and 1/4 of the resolution
MIN_LINE_PX = 16  # of line in a window with a line


@dataclass(frozen=True, slots=True)
class WSLCNNConfig:
    """Channels of the blocks."""

    channels: tuple[int, ...] = (64, 128, 256, 512, 512)


class WSLCNN(nn.Module):
    """Images (N, 3, H, W) in [0, 1], H and W multiples of 32, to logits (N, 2, H/32 - 3, W/32 - 3)."""

    def __init__(self, config: WSLCNNConfig) -> None:
        super().__init__()
        self.blocks = nn.ModuleList()
        c_in = 3
        for count, c_out in zip(CONVOLUTIONS, config.channels, strict=True):
            inputs = [c_in, *[c_out] * (count - 1)]
            self.blocks.append(nn.Sequential(*(ConvNormAct(c, c_out, "group") for c in inputs)))
            c_in = c_out
        self.head = nn.Sequential(
            nn.Conv2d(c_in, c_in, WINDOW_PX // STEP_PX), nn.ReLU(inplace=True), nn.Conv2d(c_in, 2, 1)
        )

    def forward(self, images: Tensor) -> Tensor:
        """Classify the windows of a batch."""
        return self._run(images)[0]

    def confidence(self, image: Tensor) -> Tensor:
        """Map an image (1, 3, H, W) to scores (H, W): combined feature maps in windows that have a line."""
        height, width = image.shape[2:]
        padded = F.pad(image, (0, _missing(width), 0, _missing(height)), mode="replicate")
        logits, features = self._run(padded)
        size = padded.shape[2:]
        shown = torch.stack([_normalized(f.float().mean(1, keepdim=True), size) for f in features]).mean(0)
        probability = logits.float().softmax(dim=1)[:, 1:]
        has_line = torch.where(probability >= 0.5, probability, 0.0)
        return (shown * _spread(has_line, size))[0, 0, :height, :width]

    def _run(self, images: Tensor) -> tuple[Tensor, list[Tensor]]:
        x, features = (images - 0.5) / 0.25, []
        for block in self.blocks:
            x = block(x)
            features.append(x)
            x = F.max_pool2d(x, 2)
        return self.head(x), features[:LOCALIZED_BLOCKS]


def _missing(side: int) -> int:
    return max(WINDOW_PX - side, -side % STEP_PX)


def _normalized(features: Tensor, size: torch.Size) -> Tensor:
    """Scale (1, 1, h, w) to the size, and to at most 1."""
    return F.interpolate(features / features.max().clamp(min=1e-6), size=size, mode="bilinear")


def _spread(windows: Tensor, size: torch.Size) -> Tensor:
    """(1, 1, H, W): the highest value of the windows over each pixel."""
    per_step = WINDOW_PX // STEP_PX
    padded = F.pad(windows, [per_step - 1] * 4, value=0.0)
    return F.interpolate(F.max_pool2d(padded, per_step, stride=1), size=size, mode="nearest")


@dataclass(frozen=True, slots=True)
class WSLCNNTask:
    """Train on windows with and without a line."""

    config: WSLCNNConfig = WSLCNNConfig()

    def build(self) -> WSLCNN:
        """Return the network with initial weights."""
        return WSLCNN(self.config)

    def encode(self, sample: Sample) -> tuple[Tensor, ...]:
        """Return whether each window of the image has a line, (H/32 - 3, W/32 - 3) bool."""
        drawn = drawn_lines(sample.lines, sample.image.shape[:2], 1)
        windows = np.lib.stride_tricks.sliding_window_view(drawn, (WINDOW_PX, WINDOW_PX))
        counts = windows[::STEP_PX, ::STEP_PX].sum(axis=(2, 3))
        return (torch.from_numpy(counts >= MIN_LINE_PX),)

    def sums(self, output: Tensor, *targets: Tensor) -> LossSums:
        """Return the sums of the cross-entropy over windows."""
        (has_line,) = targets
        logits = output.float().permute(0, 2, 3, 1).reshape(-1, 2)
        return of_pixels(F.cross_entropy(logits, has_line.reshape(-1).long(), reduction="none"))

    def describe(self) -> dict[str, Any]:
        """Return the network in plain values."""
        return {"rival": "wsl-cnn", "network": asdict(self.config)}
