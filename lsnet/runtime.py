"""Backends that run a network on a frame: torch, and OpenVINO where it is installed.

Each takes uint8 images (H, W, 3) RGB, H and W multiples of 16, and gives the raw maps of each: scores
(R, C) and endpoints (R, C, 4) in cell fractions, float32. On a CPU a stacked batch is slower than its
images one by one, so the backends run one frame per stream.
"""

from __future__ import annotations

import copy
import io
import logging
import os
import sys
from contextlib import redirect_stdout
from functools import lru_cache
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from lsnet.errors import LSNetError
from lsnet.model import ConvNormAct, LSNet

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Maps = tuple[NDArray[np.float32], NDArray[np.float32]]

RUNTIMES = ("auto", "torch", "openvino", "openvino-bf16", "openvino-int8")
CALIBRATION_SCENES, CALIBRATION_PX = 16, 384


class Backend(Protocol):
    """A network ready to run."""

    name: str
    precision: str
    threads: int

    def run(self, images: Sequence[NDArray[np.uint8]]) -> list[Maps]:
        """Raw maps of each image, in order."""
        ...


class Deployed(nn.Module):
    """The network from pixels to maps: (N, H, W, 3) uint8 to scores (N, R, C) and endpoints (N, R, C, 4)."""

    def __init__(self, net: LSNet) -> None:
        super().__init__()
        self.net = fold_norms(net)

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Both outputs are float32."""
        output = self.net(images.permute(0, 3, 1, 2).float() / 255)
        return output.scores.float(), output.endpoints.permute(0, 2, 3, 1).float()


def fold_norms(net: LSNet) -> LSNet:
    """A copy for inference with every BatchNorm folded into its convolution; GroupNorm cannot be."""
    folded = copy.deepcopy(net).eval()
    for block in folded.modules():
        if isinstance(block, ConvNormAct) and isinstance(block[1], nn.BatchNorm2d):
            conv = block[0]
            assert isinstance(conv, nn.Conv2d)  # noqa: S101
            block[0], block[1] = fuse_conv_bn_eval(conv, block[1]), nn.Identity()
    return folded


class TorchBackend:
    """Eager torch, channels last; on a GPU where there is one."""

    name = "torch"
    precision = "f32"

    def __init__(self, net: LSNet) -> None:
        self._device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
        self._module = Deployed(net).eval().to(self._device, memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.threads = torch.get_num_threads()

    def run(self, images: Sequence[NDArray[np.uint8]]) -> list[Maps]:
        """Raw maps of each image, in order."""
        return [self._run_one(image) for image in images]

    @torch.inference_mode()
    def _run_one(self, image: NDArray[np.uint8]) -> Maps:
        batch = torch.from_numpy(np.ascontiguousarray(image))[None].to(self._device)
        scores, endpoints = self._module(batch)
        return scores[0].cpu().numpy(), endpoints[0].cpu().numpy()


class OpenVinoBackend:
    """OpenVINO on the CPU: one stream and one thread a core, a compiled network per frame size."""

    name = "openvino"

    def __init__(self, net: LSNet, precision: str = "f32", threads: int | None = None) -> None:
        """precision: f32, bf16 or int8. threads: one a core unless told. Raises LSNetError without NNCF."""
        ov = import_openvino()
        self.precision = precision
        self.threads = threads or len(os.sched_getaffinity(0))
        self._core = ov.Core()
        example = torch.zeros(1, 64, 64, 3, dtype=torch.uint8)
        self._model = ov.convert_model(Deployed(net).eval(), example_input=example)
        if precision == "int8":
            self._model = quantised(self._model)
        self._queue_of = lru_cache(maxsize=4)(self._compile)

    def run(self, images: Sequence[NDArray[np.uint8]]) -> list[Maps]:
        """Raw maps of each image, in order; images of one size run at once, one per stream."""
        results: list[Any] = [None] * len(images)
        for height, width in dict.fromkeys(image.shape[:2] for image in images):
            queue = self._queue_of(height, width)
            for i, image in enumerate(images):
                if image.shape[:2] == (height, width):
                    queue.start_async({0: image[None]}, (results, i))
            queue.wait_all()
        return results

    def _compile(self, height: int, width: int) -> Any:
        model = self._model.clone()
        model.reshape([1, height, width, 3])
        options = {
            "INFERENCE_PRECISION_HINT": self.precision if self.precision != "int8" else "f32",
            "NUM_STREAMS": str(self.threads),
            "INFERENCE_NUM_THREADS": str(self.threads),
        }
        compiled = self._core.compile_model(model, "CPU", options)
        queue = import_openvino().AsyncInferQueue(compiled, self.threads)
        queue.set_callback(_keep_result)
        return queue


def import_openvino() -> Any:
    """The module openvino without openvino_telemetry, which tells its makers of imports and conversions.

    Raises ImportError.
    """
    sys.modules.setdefault("openvino_telemetry", None)  # type: ignore[arg-type] # as if not installed
    import openvino  # noqa: PLC0415

    return openvino


def quantised(model: Any) -> Any:
    """An OpenVINO network of `Deployed` in 8-bit integers, their ranges set on a few drawn scenes (NNCF).

    The same network gives the same one each time. Raises LSNetError when NNCF is not installed.
    """
    if find_spec("nncf") is None:
        raise LSNetError("NNCF is not installed; pip install 'lsnet-pipe[int8]' or use --runtime openvino")
    import nncf  # noqa: PLC0415

    from lsnet.synth.backgrounds import BackgroundPool  # noqa: PLC0415
    from lsnet.synth.dataset import SyntheticScenes  # noqa: PLC0415

    nncf.set_log_level(logging.ERROR)
    scenes = SyntheticScenes(BackgroundPool([]), CALIBRATION_PX)
    images = nncf.Dataset([scenes[i].image[None] for i in range(CALIBRATION_SCENES)])
    with redirect_stdout(io.StringIO()):  # NNCF draws progress bars there
        return nncf.quantize(
            model, images, preset=nncf.QuantizationPreset.MIXED, subset_size=CALIBRATION_SCENES
        )


def _keep_result(request: Any, place: tuple[list[Any], int]) -> None:
    results, i = place
    results[i] = tuple(request.get_output_tensor(k).data[0].copy() for k in (0, 1))


def open_backend(net: LSNet, runtime: str) -> Backend:
    """The backend asked for; `auto` takes a GPU, then OpenVINO, in bf16 where the CPU has it, then torch.

    Raises LSNetError for an unknown one or one that is not installed.
    """
    if runtime not in RUNTIMES:
        raise LSNetError(f"no runtime {runtime!r}; choose one of {', '.join(RUNTIMES)}")
    has_openvino = find_spec("openvino") is not None
    if runtime.startswith("openvino") and not has_openvino:
        raise LSNetError(
            "OpenVINO is not installed; pip install 'lsnet-pipe[openvino]' or use --runtime torch"
        )
    if runtime == "torch" or not has_openvino or (runtime == "auto" and torch.cuda.is_available()):
        return TorchBackend(net)
    return OpenVinoBackend(net, _precision_of(runtime))


def _precision_of(runtime: str) -> str:
    if runtime == "auto":
        core = import_openvino().Core()
        return "bf16" if "BF16" in core.get_property("CPU", "OPTIMIZATION_CAPABILITIES") else "f32"
    return runtime.partition("-")[2] or "f32"
