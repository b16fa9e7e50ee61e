"""Tiny networks with random weights, and random images."""

from __future__ import annotations

from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import torch

from lsnet.model import LSNet
from lsnet.network_config import LSNetConfig
from lsnet.runtime.choice import import_openvino
from lsnet.weights import save_weights
from lsnet.weights_file import WeightsCard

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

torch.set_num_threads(1)  # threads on tiny networks only wait for each other

TINY = LSNetConfig(
    stem_channels=4,
    stage_channels=(4, 8, 8),
    head_channels=8,
    norm="batch",
    downsample="first",
    residual=True,
    pixel_mean=128 / 255,  # the grey that backends put beside images
)


RNG = np.random.default_rng(0)


def photo(height: int, width: int) -> NDArray[np.uint8]:
    """Return an image of random pixels."""
    return RNG.integers(0, 256, (height, width, 3), dtype=np.uint8)


def tiny_net(seed: int = 0, config: LSNetConfig = TINY) -> LSNet:
    """Return a network in evaluation mode, with norms other than identity and scores on both sides of 0.5."""
    torch.manual_seed(seed)
    net = LSNet(config)
    with torch.no_grad():
        for module in net.modules():
            if isinstance(module, torch.nn.BatchNorm2d):
                module.running_mean.normal_(0, 0.1)
                module.running_var.uniform_(0.5, 1.5)
                module.weight.uniform_(0.5, 1.5)
                module.bias.normal_(0, 0.1)
        net.classifier[-1].weight.normal_(0, 1.0)
        net.classifier[-1].bias.zero_()
        net.regressor[-1].weight.normal_(0, 0.1)
    return net.eval()


def save_tiny(path: Path, seed: int = 0, **card: object) -> Path:
    """Write a weights file with a tiny network."""
    values = {"name": "tiny", "preset": "fast", "network": TINY, "min_score": 0.5} | card
    save_weights(path, tiny_net(seed), WeightsCard(**values))
    return path


def openvino_or_skip() -> Any:
    """Import openvino as the program does, or skip the test."""
    if find_spec("openvino") is None:
        pytest.skip("openvino is not installed")
    return import_openvino()
