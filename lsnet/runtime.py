"""Backends that run a network on images: torch, and OpenVINO if installed.

A backend takes uint8 RGB images (H, W, 3), H and W multiples of 16, and returns the raw maps of each: scores
(R, C) and endpoints (R, C, 4) in cell fractions, float32. On a CPU a stacked batch is slower than its images
one by one, so the backends run one image per stream.
"""

from __future__ import annotations

import copy
import os
import warnings
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from lsnet.model import ConvNormAct, LSNet
from lsnet.quantization import quantize_int8
from lsnet.runtime_choice import choose_backend, import_openvino, openvino_core

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lsnet.arrays import ImageArray, Maps


class Backend(Protocol):
    """A network that is ready to run."""

    name: str
    precision: str
    threads: int

    def run(self, images: Sequence[ImageArray]) -> list[Maps]:
        """Return the raw maps of each image, in order."""
        ...


class InferenceModule(nn.Module):
    """The network from pixels to maps: (N, H, W, 3) uint8 to scores (N, R, C) and endpoints (N, R, C, 4)."""

    def __init__(self, net: LSNet) -> None:
        super().__init__()
        self.net = fold_norms(net)

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Run a batch; both outputs are float32."""
        output = self.net(images.permute(0, 3, 1, 2).float() / 255)
        return output.scores.float(), output.endpoints.permute(0, 2, 3, 1).float()


def fold_norms(net: LSNet) -> LSNet:
    """Return a copy for inference with each BatchNorm folded into its convolution; GroupNorm stays."""
    folded = copy.deepcopy(net).eval()
    for block in folded.modules():
        if isinstance(block, ConvNormAct) and isinstance(block[1], nn.BatchNorm2d):
            conv = block[0]
            assert isinstance(conv, nn.Conv2d)  # noqa: S101
            block[0], block[1] = fuse_conv_bn_eval(conv, block[1]), nn.Identity()
    return folded


class TorchBackend:
    """Eager torch, channels last; on a GPU if there is one."""

    name = "torch"
    precision = "f32"

    def __init__(self, net: LSNet) -> None:
        self._device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
        self._module = InferenceModule(net).eval().to(self._device, memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.threads = torch.get_num_threads()

    def run(self, images: Sequence[ImageArray]) -> list[Maps]:
        """Return the raw maps of each image, in order."""
        return [self._run_one(image) for image in images]

    @torch.inference_mode()
    def _run_one(self, image: ImageArray) -> Maps:
        batch = torch.from_numpy(np.ascontiguousarray(image))[None].to(self._device)
        scores, endpoints = self._module(batch)
        return scores[0].cpu().numpy(), endpoints[0].cpu().numpy()


class OpenVinoBackend:
    """OpenVINO on the CPU: an image per core, fewer if they are large; a compiled network per image size."""

    name = "openvino"

    def __init__(self, net: LSNet, precision: str = "f32", threads: int | None = None) -> None:
        """Convert the network.

        Args:
            net: The network.
            precision: f32, bf16 or int8.
            threads: Default: one per core.

        Raises:
            LSNetError: OpenVINO, or NNCF for int8, is not installed.
        """
        self.precision = precision
        self.threads = threads or len(os.sched_getaffinity(0))
        self._max_pixels = net.config.pixels_at_once
        example = torch.zeros(1, 64, 64, 3, dtype=torch.uint8)
        with warnings.catch_warnings():
            # The converter calls torch.jit.trace, which torch deprecates. torch.export gives the same
            # network bit for bit, but takes three times as long and warns too.
            warnings.simplefilter("ignore", DeprecationWarning)
            self._model = import_openvino().convert_model(InferenceModule(net).eval(), example_input=example)
        if precision == "int8":
            self._model = quantize_int8(self._model)
        self._queue_of = lru_cache(maxsize=4)(self._compile)

    def run(self, images: Sequence[ImageArray]) -> list[Maps]:
        """Return the raw maps of each image, in order; images of one size run in parallel, one per stream."""
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
        streams = max(1, min(self.threads, self._max_pixels // (height * width)))
        options = {
            "INFERENCE_PRECISION_HINT": self.precision if self.precision != "int8" else "f32",
            "NUM_STREAMS": str(streams),
            "INFERENCE_NUM_THREADS": str(self.threads),
        }
        compiled = openvino_core().compile_model(model, "CPU", options)
        queue = import_openvino().AsyncInferQueue(compiled, streams)
        queue.set_callback(_store_result)
        return queue


def _store_result(request: Any, place: tuple[list[Any], int]) -> None:
    results, i = place
    results[i] = tuple(request.get_output_tensor(k).data[0].copy() for k in (0, 1))


def open_backend(net: LSNet, runtime: str) -> Backend:
    """Open a backend by the name of a runtime, see `choose_backend`.

    Raises:
        LSNetError: The name is unknown, or the runtime is not installed.
    """
    name, precision = choose_backend(runtime, has_gpu=torch.cuda.is_available())
    return TorchBackend(net) if name == "torch" else OpenVinoBackend(net, precision)
