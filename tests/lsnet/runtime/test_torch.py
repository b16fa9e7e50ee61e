"""Stacked images and short memory: the code of a GPU, run on the CPU."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
import torch
from nets import photo, tiny_net

from lsnet import LSNetError
from lsnet.runtime.torch import TorchBackend

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from lsnet.arrays import Maps

IMAGES = [photo(64, 64 + 16 * (i % 2)) for i in range(11)]


class SmallDevice(TorchBackend):
    """Has memory for so many images, and keeps how many were run together."""

    def __init__(self, capacity: int, precision: str = "f32") -> None:
        super().__init__(tiny_net(), precision)
        self.n_images, self.capacity, self.stacks = 8, capacity, []

    def _forward(self, images: Sequence[NDArray[np.uint8]]) -> list[Maps]:
        if len(images) > self.capacity:
            raise torch.OutOfMemoryError("planted")
        self.stacks.append(len(images))
        return super()._forward(images)


@pytest.mark.parametrize(("capacity", "stacks"), [(8, [6, 5]), (3, [3, 3, 3, 2]), (2, None), (1, [1] * 11)])
def test_stacks_equal_single_images_whatever_the_memory(capacity: int, stacks: list[int] | None) -> None:
    device = SmallDevice(capacity)
    for together, alone in zip(device.run(IMAGES), TorchBackend(tiny_net()).run(IMAGES), strict=True):
        np.testing.assert_allclose(together[0], alone[0], atol=1e-5)
        np.testing.assert_allclose(together[1], alone[1], atol=1e-4)
    assert stacks is None or device.stacks == stacks
    device.stacks.clear()
    device.run(IMAGES)
    assert max(device.stacks) <= capacity  # it remembers what fits


def test_an_image_that_does_not_fit_alone_is_one_line() -> None:
    with pytest.raises(LSNetError, match="an image of 64x64 does not fit the memory of cpu; use the device"):
        SmallDevice(0).run(IMAGES)


@pytest.mark.parametrize(("precision", "tolerance"), [("bf16", 0.05), ("f16", 0.01)])
def test_half_precision_agrees_with_f32(precision: str, tolerance: float) -> None:
    ours, theirs = (TorchBackend(tiny_net(), p).run(IMAGES[:1])[0] for p in (precision, "f32"))
    assert ours[0].dtype == ours[1].dtype == np.float32
    np.testing.assert_allclose(ours[0], theirs[0], atol=tolerance)
    np.testing.assert_allclose(ours[1], theirs[1], atol=tolerance)
