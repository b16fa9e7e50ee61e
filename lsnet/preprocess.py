"""From an image to the input of the network: resized, and padded to whole grid cells."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from lsnet.tiles import STRIDE_PX

if TYPE_CHECKING:
    from lsnet.arrays import ImageArray

MIN_SIDE_PX = 32  # one grid cell
ENLARGE_TO_PX = 384  # the size of training images; thin wires are lost in much smaller ones
MAX_SCALE = 4.0


@dataclass(frozen=True, slots=True, eq=False)
class PreparedImage:
    """An image as the network sees it, with what is needed to map results back.

    Attributes:
        pixels: (H, W, 3) uint8, H and W multiples of 16; below and to the right of `scaled_size` padding.
        scale: The factor asked for; sides are rounded to whole pixels.
        scaled_size: (height, width) after resizing, without padding.
        source_size: (height, width) of the image as given.
    """

    pixels: ImageArray
    scale: float
    scaled_size: tuple[int, int]
    source_size: tuple[int, int]

    @property
    def padded_size(self) -> tuple[int, int]:
        """(height, width) of `pixels`."""
        return self.pixels.shape[0], self.pixels.shape[1]


def prepare(image: ImageArray, scale: float) -> PreparedImage:
    """Resize an image (H, W, 3) by `scale` and repeat its borders up to multiples of 16.

    What needs neither is not copied.
    """
    source_size = (image.shape[0], image.shape[1])
    height, width = max(1, round(source_size[0] * scale)), max(1, round(source_size[1] * scale))
    if (height, width) != source_size:
        how = cv2.INTER_AREA if height < source_size[0] else cv2.INTER_LINEAR
        image = np.asarray(cv2.resize(image, (width, height), interpolation=how), np.uint8)
    below = max(MIN_SIDE_PX - height, -height % STRIDE_PX)
    right = max(MIN_SIDE_PX - width, -width % STRIDE_PX)
    if below or right:
        image = np.asarray(cv2.copyMakeBorder(image, 0, below, 0, right, cv2.BORDER_REPLICATE), np.uint8)
    return PreparedImage(np.ascontiguousarray(image), scale, (height, width), source_size)


def automatic_scale(image_size: tuple[int, int]) -> float:
    """Return the whole factor from 1 to 4 that brings an image of (height, width) near the training size."""
    return float(min(max(ENLARGE_TO_PX // max(min(image_size), 1), 1), MAX_SCALE))
