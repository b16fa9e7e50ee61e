"""The network by torch, on the CPU or a GPU."""

from __future__ import annotations

import copy
from threading import Lock
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from lsnet.errors import LSNetError
from lsnet.model import ConvNormAct, LSNet

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from lsnet.arrays import ImageArray, Maps

DTYPES = {"f32": torch.float32, "bf16": torch.bfloat16, "f16": torch.float16}
CENTRE = 128  # of pixels, about their mean
STACKED = 8  # images at a time on a GPU


class InferenceModule(nn.Module):
    """The network from pixels to maps: (N, H, W, 3) uint8 to scores (N, R, C) and endpoints (N, R, C, 4)."""

    def __init__(self, net: LSNet) -> None:
        super().__init__()
        self.net = fold_pixels(fold_norms(net))

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Run a batch; both outputs are float32."""
        pixels = (images.to(self.net.dtype) - CENTRE).permute(0, 3, 1, 2)
        output = self.net.run(pixels)
        return output.scores.float(), output.endpoints.permute(0, 2, 3, 1).float()


def fold_pixels(net: LSNet) -> LSNet:
    """Fold the normalisation of pixels into the first convolution of a network, for pixels less `CENTRE`.

    Changes the network in place. `CENTRE` is a whole number so that pixels stay exact in bf16 and in 8 bits.
    Convolutions then pad with this grey, half a level beside that of training.
    """
    first = next(module for module in net.modules() if isinstance(module, nn.Conv2d))
    with torch.no_grad():
        first.weight /= 255 * net.config.pixel_std
        shift = (CENTRE - 255 * net.config.pixel_mean) * first.weight.sum((1, 2, 3))
        first.bias = nn.Parameter(shift if first.bias is None else first.bias + shift)
    return net


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
    """Eager torch, channels last. On a GPU images of one size are stacked, fewer where memory is short."""

    name = "torch"
    n_calls = 1

    def __init__(
        self, net: LSNet, precision: str = "f32", device: str = "cpu", threads: int | None = None
    ) -> None:
        """Take a network.

        Args:
            net: The network.
            precision: f32, bf16 or f16.
            device: cpu or cuda:N.
            threads: Of the CPU, for all of torch. Default: as torch has them.
        """
        if threads:
            torch.set_num_threads(threads)
        self.precision, self.threads = precision, torch.get_num_threads()
        self.n_images = 1 if device == "cpu" else STACKED
        self._device, self._max_pixels = torch.device(device), STACKED * net.config.pixels_at_once
        module = InferenceModule(net).eval().to(self._device, DTYPES[precision])
        self._module = module.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self._lock = Lock()

    def run(self, images: Sequence[ImageArray]) -> list[Maps]:
        """Return the raw maps of each image, in order.

        Raises:
            LSNetError: A single image is too large for the memory of the device.
        """
        results: list[Maps | None] = [None] * len(images)
        with self._lock:
            for numbers in self._stacks([image.shape[:2] for image in images]):
                maps = self._run_stack([images[i] for i in numbers])
                for i, result in zip(numbers, maps, strict=True):
                    results[i] = result
        return [result for result in results if result is not None]

    def _stacks(self, sizes: Sequence[tuple[int, ...]]) -> Iterator[list[int]]:
        """Numbers of the images that are stacked: of one size, and not too many pixels."""
        for size in dict.fromkeys(sizes):
            numbers = [i for i, other in enumerate(sizes) if other == size]
            count = max(1, min(self.n_images, self._max_pixels // (size[0] * size[1])))
            yield from (numbers[i : i + count] for i in range(0, len(numbers), count))

    def _run_stack(self, images: Sequence[ImageArray]) -> list[Maps]:
        """Run images of one size together, in halves where memory is short."""
        try:
            return self._forward(images)
        except torch.OutOfMemoryError as err:
            if len(images) == 1:
                height, width = images[0].shape[:2]
                raise LSNetError(
                    f"an image of {width}x{height} does not fit the memory of {self._device}; "
                    "use the device cpu, or a smaller scale"
                ) from err
        torch.cuda.empty_cache()
        half = self.n_images = max(1, len(images) // 2)
        return [*self._run_stack(images[:half]), *self._run_stack(images[half:])]

    @torch.inference_mode()
    def _forward(self, images: Sequence[ImageArray]) -> list[Maps]:
        scores, endpoints = (part.cpu().numpy() for part in self._module(self._to_device(images)))
        return list(zip(scores, endpoints, strict=True))

    def _to_device(self, images: Sequence[ImageArray]) -> Tensor:
        """(N, H, W, 3) uint8 on the device, by way of memory that it reads without a copy."""
        if self._device.type == "cpu" and len(images) == 1:
            return torch.from_numpy(np.ascontiguousarray(images[0]))[None]
        shape = (len(images), *images[0].shape)
        staged = torch.empty(shape, dtype=torch.uint8, pin_memory=self._device.type != "cpu")
        for place, image in zip(staged, images, strict=True):
            place.numpy()[:] = image
        return staged.to(self._device, non_blocking=True)
