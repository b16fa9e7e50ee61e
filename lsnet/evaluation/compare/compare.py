"""Networks of several sizes after a short training: ODS and CPU time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from importlib.util import find_spec
from typing import TYPE_CHECKING

import torch

from lsnet.detector import Detector
from lsnet.errors import LSNetError
from lsnet.evaluation.compare.trainings import Result, Trainings, Variant
from lsnet.evaluation.grids import OnlyGrids, Remembered
from lsnet.evaluation.pixels import PixelReport, evaluate
from lsnet.evaluation.speed import least_cpu_ms
from lsnet.model import LSNet
from lsnet.network_config import PRESETS, LSNetConfig
from lsnet.runtime.openvino import OpenVinoBackend
from lsnet.runtime.torch import TorchBackend
from lsnet.training.tasks import LSNetTask
from lsnet.weights import Weights
from lsnet.weights_file import WeightsCard

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from torch import nn

    from lsnet.runtime.backend import Backend

FAST = PRESETS["fast"]


@dataclass(frozen=True, slots=True)
class SizedVariant:
    """A network by name, trained with the default loss."""

    name: str
    network: LSNetConfig = FAST
    seed: int = 0

    def variant(self) -> Variant:
        """Return what is trained."""
        return Variant(self.name, LSNetTask(self.network), self.seed)


NETWORKS = (
    SizedVariant("fast"),
    SizedVariant("fast, another seed", seed=1),
    SizedVariant("wider", replace(FAST, stem_channels=24, stage_channels=(32, 64, 128), head_channels=128)),
    SizedVariant("narrower", replace(FAST, stage_channels=(24, 32, 64), head_channels=64)),
    SizedVariant("no context block", replace(FAST, context_blocks=0)),
    SizedVariant("deep", replace(FAST, stage_blocks=2)),
    SizedVariant("GroupNorm", replace(FAST, norm="group")),
    SizedVariant("head of 48", replace(FAST, head_channels=48)),
)


@dataclass(frozen=True, slots=True)
class Row:
    """A result with the CPU time of a 512 x 512 image on one thread, ms, by runtime."""

    result: Result
    cpu_ms: dict[str, float]


def compare_networks(trainings: Trainings, variants: Sequence[SizedVariant]) -> list[Row]:
    """Train each network that has no result yet, and time all of them. Raises LSNetError."""
    sets = trainings.comparison.sets
    results = [trainings.score(v.variant(), "ODS at 1 px", lambda net: ods(net, sets)) for v in variants]
    return [Row(r, cpu_ms_of(v.network)) for r, v in zip(results, variants, strict=True)]


@cache
def cpu_ms_of(network: LSNetConfig) -> dict[str, float]:
    """Measure the CPU time of a 512 x 512 image on one thread, ms, with the installed runtimes."""
    torch.manual_seed(0)
    net = LSNet(network).eval()
    backends: dict[str, Backend] = {"torch": TorchBackend(net)}
    if find_spec("openvino") is not None:
        precisions = ["f32", "bf16", *(["int8"] if find_spec("nncf") is not None else [])]
        backends |= {f"openvino {p}": OpenVinoBackend.convert(net, p, threads=1) for p in precisions}
    return {name: least_cpu_ms(backend) for name, backend in backends.items()}


def ods(net: nn.Module, sets: Sequence[Path]) -> dict[str, float]:
    """Return the ODS at 1 px of the raw segments of a network, by set."""
    found = {}
    detector = grids_of(net)("MHVC")
    for folder in sets:
        (report,) = evaluate(detector, folder, min_score=0.5, tolerances_px=(1.0,))
        if not isinstance(report, PixelReport):
            raise LSNetError(f"{folder}: has no pixel truth; give folders with masks or boundaries")
        found[str(folder)] = report.ods.f1
    return found


def grids_of(net: nn.Module) -> Callable[[str], Detector]:
    """Return a function that opens a detector around a network in memory, with some of its grids."""
    if not isinstance(net, LSNet):
        raise LSNetError("only LS-Net reports segments")
    weights = Weights(net, WeightsCard("compared", "compared", net.config, min_score=0.5), "")
    backend = Remembered(TorchBackend(net))
    return lambda grids: Detector(weights, OnlyGrids(backend, grids), scale=None, min_score=0.05)
