"""WD-DCNN (Madaan et al., IROS 2017), a rival that classifies pixels by dilated convolutions.

    input image
    Conv3-32 dilation 1, 1, 2, 4, 8, 16, 1
    Conv1-2

The LS-Net paper does not print its layers, which were chosen in a grid search. Assumed are the dilations of
the context module of Yu and Koltun, at full resolution with 32 channels. The variants of the LS-Net paper are
two switches: GroupNorm after each convolution (GN), and the focal loss for the class-balanced cross-entropy
(FL). The true pixels are the centrelines, `LINE_PX` wide: training images have no masks.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from torch import nn

from lsnet.model import GROUP_SIZE
from lsnet.training.losses import LossSums, focal_loss

if TYPE_CHECKING:
    from collections.abc import Sequence

    from torch import Tensor

    from lsnet.arrays import Mask, RealArray
    from lsnet.synth.drawing import Sample

LINE_PX = 3


@dataclass(frozen=True, slots=True)
class WDDCNNConfig:
    """Layers and loss of one variant; alpha and gamma are of the focal loss, as for LS-Net."""

    channels: int = 32
    dilations: tuple[int, ...] = (1, 1, 2, 4, 8, 16, 1)
    group_norm: bool = False
    focal: bool = False
    alpha: float = 0.5
    gamma: float = 2.0


class WDDCNN(nn.Sequential):
    """Images (N, 3, H, W) in [0, 1] to logits (N, 2, H, W), without and with a wire."""

    def __init__(self, config: WDDCNNConfig) -> None:
        layers: list[nn.Module] = []
        c_in = 3
        for dilation in config.dilations:
            layers.append(nn.Conv2d(c_in, config.channels, 3, padding=dilation, dilation=dilation))
            if config.group_norm:
                layers.append(nn.GroupNorm(max(1, config.channels // GROUP_SIZE), config.channels))
            layers.append(nn.ReLU(inplace=True))
            c_in = config.channels
        classifier = nn.Conv2d(c_in, 2, 1)
        super().__init__(*layers, classifier)
        for layer in self:
            if isinstance(layer, nn.Conv2d):
                nn.init.kaiming_normal_(layer.weight, nonlinearity="relu")
        # As LS-Net starts. With large weights here, networks with GroupNorm learned nothing for 200 batches.
        nn.init.normal_(classifier.weight, std=0.01)
        prior = 1.0 if config.focal else 0.0  # the balanced loss is least at even odds
        classifier.bias = nn.Parameter(torch.tensor([prior, -prior]))

    def forward(self, images: Tensor) -> Tensor:
        """Run a batch."""
        logits: Tensor = super().forward((images - 0.5) / 0.25)  # type: ignore[no-untyped-call]
        return logits

    def confidence(self, image: Tensor) -> Tensor:
        """Map an image (1, 3, H, W) to the probability of a wire at each pixel (H, W)."""
        scores: Tensor = self(image).float().softmax(dim=1)[0, 1]
        return scores


@dataclass(frozen=True, slots=True)
class WDDCNNTask:
    """Train one variant on the drawn centrelines."""

    config: WDDCNNConfig = WDDCNNConfig()

    def build(self) -> WDDCNN:
        """Return the network with initial weights."""
        return WDDCNN(self.config)

    def encode(self, sample: Sample) -> tuple[Tensor, ...]:
        """Return the (H, W) mask of the lines."""
        return (torch.from_numpy(drawn_lines(sample.lines, sample.image.shape[:2], LINE_PX)),)

    def sums(self, output: Tensor, *targets: Tensor) -> LossSums:
        """Return the sums over pixels: each pixel counts in the mean."""
        (mask,) = targets
        logits, is_wire = output.float().permute(0, 2, 3, 1).reshape(-1, 2), mask.reshape(-1)
        config = self.config
        if config.focal:
            losses = focal_loss(logits, is_wire, config.alpha, config.gamma)
        else:
            losses = class_balanced(logits, is_wire)
        return of_pixels(losses)

    def describe(self) -> dict[str, Any]:
        """Return the network in plain values."""
        return {"rival": "wd-dcnn", "network": asdict(self.config)}


def class_balanced(logits: Tensor, is_positive: Tensor) -> Tensor:
    """Return the cross-entropy (N,) of logits (N, 2) in which both classes have the same total weight."""
    share = is_positive.float().mean()
    weights = torch.where(is_positive, 1 - share, share)
    return weights * F.cross_entropy(logits, is_positive.long(), reduction="none")


def of_pixels(losses: Tensor) -> LossSums:
    """Return the sums of losses (N,) whose mean is over all N."""
    total, count = losses.sum(), torch.full((), float(len(losses)), device=losses.device)
    return LossSums(total, total, torch.zeros_like(total), count, count)


def drawn_lines(lines: Sequence[RealArray], size: tuple[int, int], width_px: int) -> Mask:
    """Return the (height, width) mask of polylines (K, 2), as wide along either axis as stated.

    OpenCV's own thick lines are wider.
    """
    mask = np.zeros(size, np.uint8)
    for line in lines:
        points = np.floor(line).clip(-9999, 9999).astype(np.int32)
        cv2.polylines(mask, [points[:, None]], isClosed=False, color=1)
    return np.asarray(cv2.dilate(mask, np.ones((width_px, width_px))) > 0)
