"""Synthetic training images without end: sample i of a seed is always the same image."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import cv2
import numpy as np

from lsnet.synth.clutter.clutter import add_clutter
from lsnet.synth.conditions import augment_further
from lsnet.synth.scene import add_cables

if TYPE_CHECKING:
    from lsnet.arrays import Floats, Floats32, ImageArray
    from lsnet.synth.backgrounds import BackgroundPool

EMPTY_SHARE = 0.2  # of images have no cable
SMALL_SHARE = 0.25  # of images have a low resolution, enlarged two to four times as by `Detector`


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """An image and its lines.

    Attributes:
        image: uint8 (size, size, 3) RGB.
        lines: (K, 2) points x, y in pixels, which may be outside the image.
    """

    image: ImageArray
    lines: list[Floats]


class SampleSource(Protocol):
    """Samples by index; the same index gives the same sample."""

    @property
    def size(self) -> int:
        """Side of the square images, pixels."""
        ...

    def __getitem__(self, index: int) -> Sample:
        """Return sample `index`, any number from 0."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class SyntheticScenes:
    """Cables drawn over backgrounds and clutter, augmented."""

    pool: BackgroundPool
    size: int = 384
    seed: int = 0

    def __getitem__(self, index: int) -> Sample:
        rng = np.random.default_rng([self.seed, index])
        factor = int(rng.integers(2, 5)) if rng.random() < SMALL_SHARE else 1
        small = self._seen(rng, self.size // factor)
        size = (self.size, self.size)
        image = np.asarray(cv2.resize(small.image, size, interpolation=cv2.INTER_LINEAR), np.uint8)
        return Sample(image, [line * (self.size / small.image.shape[0]) for line in small.lines])

    def _seen(self, rng: np.random.Generator, size: int) -> Sample:
        scene = to_uint8(self.pool.sample(rng, size))
        add_clutter(scene, rng, lambda: to_uint8(self.pool.sample(rng, size)))
        image = scene.astype(np.float32)
        lines = add_cables(image, rng) if rng.random() >= EMPTY_SHARE else []
        image, lines = augment_further(image, lines, rng)
        return Sample(to_uint8(image), lines)


def to_uint8(image: Floats32) -> ImageArray:
    """Round and clip to [0, 255]."""
    return np.clip(np.round(image), 0, 255).astype(np.uint8)
