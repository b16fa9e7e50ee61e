"""Sharpness and brightness of images, measured on a copy of bounded size."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

if TYPE_CHECKING:
    from inspect_pipeline.arrays import ImageArray

_MAX_SIDE_PX = 1024


@dataclass(frozen=True, slots=True)
class ImageQuality:
    """sharpness: variance of the Laplacian of luma; mean_luma: 0 to 255."""

    sharpness: float
    mean_luma: float


def measure_quality(image: ImageArray) -> ImageQuality:
    """Measure a uint8 (height, width, 3) RGB image, shrunk by a whole factor to at most 1024 px a side."""
    luma = _shrink(np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), np.uint8))
    laplacian = cv2.Laplacian(luma, cv2.CV_16S)
    return ImageQuality(float(cv2.meanStdDev(laplacian)[1].item() ** 2), float(cv2.mean(luma)[0]))


def _shrink(luma: ImageArray) -> ImageArray:
    """Return (height, width) means of square blocks; the blocks of images with few rows are less high."""
    factor = -(-max(luma.shape) // _MAX_SIDE_PX)
    if factor == 1:
        return luma
    tall, wide = (min(factor, side) for side in luma.shape)
    height, width = luma.shape[0] // tall, luma.shape[1] // wide
    blocks = luma[: height * tall, : width * wide]
    return np.asarray(cv2.resize(blocks, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
