"""Rivals that are trained like LS-Net: their presets for `model train`, and their runs as detectors."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from lsnet.errors import LSNetError
from lsnet.evaluation.baselines.wd_dcnn import WDDCNNConfig, WDDCNNTask
from lsnet.evaluation.baselines.wsl_cnn import WSLCNNConfig, WSLCNNTask
from lsnet.network_config import PRESETS
from lsnet.training.checkpoints import load_checkpoint
from lsnet.training.devices import choose_device
from lsnet.training.options import with_options
from lsnet.training.tasks import open_task

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from torch import nn

    from lsnet.arrays import Floats32, ImageArray
    from lsnet.training.tasks import Task

RIVALS: dict[str, WDDCNNConfig | WSLCNNConfig] = {
    "wsl-cnn": WSLCNNConfig(),
    "wd-dcnn": WDDCNNConfig(),
    "wd-dcnn-gn": WDDCNNConfig(group_norm=True),
    "wd-dcnn-fl": WDDCNNConfig(focal=True),
    "wd-dcnn-gnfl": WDDCNNConfig(group_norm=True, focal=True),
}


def open_any_task(
    preset: str, network: Sequence[str] = (), loss: Sequence[str] = (), *, longest: bool = False
) -> Task:
    """Return the task of a preset of LS-Net or of a rival, with options as NAME=VALUE.

    Raises:
        LSNetError: The preset or an option is unknown.
    """
    if preset not in RIVALS:
        if preset not in PRESETS:
            names = ", ".join([*PRESETS, *RIVALS])
            raise LSNetError(f"no preset {preset!r}; choose one of {names}")
        return open_task(preset, network, loss, longest=longest)
    if loss:
        raise LSNetError(f"the loss of {preset} is part of its network; leave out the options of the loss")
    return rival_task(with_options(RIVALS[preset], network))


def rival_task(config: WDDCNNConfig | WSLCNNConfig) -> Task:
    """Return the task of a rival's network."""
    return WDDCNNTask(config) if isinstance(config, WDDCNNConfig) else WSLCNNTask(config)


class LearnedRival:
    """A trained rival, which scores pixels instead of reporting segments."""

    def __init__(self, net: nn.Module) -> None:
        self._device = choose_device("auto")
        self._net: Any = net.eval().to(self._device)

    @classmethod
    def load(cls, run: Path) -> LearnedRival:
        """Load the best weights of a run. Raises LSNetError for a run of another network or none."""
        best = load_checkpoint(run / "best.pt")
        kinds: dict[str, Any] = {"wd-dcnn": WDDCNNConfig, "wsl-cnn": WSLCNNConfig}
        try:
            recipe = best["recipe"]
            net = rival_task(kinds[recipe["rival"]](**recipe["network"])).build()
            net.load_state_dict(best["average"])
        except (LookupError, TypeError, RuntimeError) as err:
            raise LSNetError(f"{run}: not a run of a rival; give one trained as {', '.join(RIVALS)}") from err
        return cls(net)

    @torch.inference_mode()
    def confidence(self, image: ImageArray) -> Floats32:
        """Return (H, W) scores from 0 to 1 of uint8 (H, W, 3) RGB."""
        pixels = torch.from_numpy(np.ascontiguousarray(image)).to(self._device)
        scores = self._net.confidence(pixels.permute(2, 0, 1)[None].float() / 255)
        return np.asarray(scores.cpu().numpy(), np.float32)
