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
    """Measure a uint8 (height, width, 3) RGB image, shrunk to a longer side of 1024 px if it is larger."""
    luma = cv2.cvtColor(_shrink(image), cv2.COLOR_RGB2GRAY)
    laplacian = cv2.Laplacian(luma, cv2.CV_32F)
    return ImageQuality(sharpness=float(laplacian.var()), mean_luma=float(luma.mean()))


def _shrink(image: ImageArray) -> ImageArray:
    height, width = image.shape[:2]
    scale = _MAX_SIDE_PX / max(height, width)
    if scale >= 1:
        return image
    # Keep one row or column of images that have only a few, such as those of line cameras.
    fx, fy = max(scale, 1 / width), max(scale, 1 / height)
    small = cv2.resize(image, None, fx=fx, fy=fy, interpolation=cv2.INTER_AREA)
    return small.astype(np.uint8, copy=False)
