"""Synthetic training images without end: sample i of a seed is always the same image."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import cv2
import numpy as np

from lsnet.synth.clutter.borders import road_bend
from lsnet.synth.clutter.clutter import add_clutter
from lsnet.synth.conditions import augment_further
from lsnet.synth.scene import add_cables, finish_for
from lsnet.synth.towers import add_tower

if TYPE_CHECKING:
    from lsnet.arrays import Floats, Floats32, ImageArray
    from lsnet.synth.backgrounds import BackgroundPool

EMPTY_SHARE = 0.2  # of images have no cable
SMALL_SHARE = 0.25  # of images have a low resolution, enlarged two to four times as by `Detector`
TOWER_SHARE = 0.2  # of the others show a tower from near, whose wires end there
PHOTOGRAPH_SHARE = 0.3  # of the others are photographs near their own resolution, without clutter
BEND_SHARE = 0.25  # of these get lines along a bend


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
    """Cables and towers drawn over backgrounds and clutter, augmented."""

    pool: BackgroundPool
    size: int = 384
    seed: int = 0

    def __getitem__(self, index: int) -> Sample:
        rng = np.random.default_rng([self.seed, index])
        factor = int(rng.integers(2, 5)) if rng.random() < SMALL_SHARE else 1
        small = self._seen(rng, self.size // factor, has_details=factor == 1)
        size = (self.size, self.size)
        image = np.asarray(cv2.resize(small.image, size, interpolation=cv2.INTER_LINEAR), np.uint8)
        return Sample(image, [line * (self.size / small.image.shape[0]) for line in small.lines])

    def _seen(self, rng: np.random.Generator, size: int, *, has_details: bool) -> Sample:
        scene = self._scene(rng, size, is_photograph=has_details and rng.random() < PHOTOGRAPH_SHARE)
        lines: list[Floats] = []
        if has_details and rng.random() < TOWER_SHARE:
            lines += add_tower(scene, rng, finish_for(scene.astype(np.float32), rng))
        image = scene.astype(np.float32)
        if rng.random() >= (0.6 if lines else EMPTY_SHARE):
            lines += add_cables(image, rng)
        image, lines = augment_further(image, lines, rng)
        return Sample(to_uint8(image), lines)

    def _scene(self, rng: np.random.Generator, size: int, *, is_photograph: bool) -> ImageArray:
        if is_photograph:
            photograph = self.pool.photograph(rng, size)
            scene = np.asarray(cv2.resize(photograph, (size, size), interpolation=cv2.INTER_CUBIC), np.uint8)
            if rng.random() < BEND_SHARE:
                road_bend(scene, rng)
            return scene
        scene = to_uint8(self.pool.sample(rng, size))
        add_clutter(scene, rng, lambda: to_uint8(self.pool.sample(rng, size)))
        return scene


def to_uint8(image: Floats32) -> ImageArray:
    """Round and clip to [0, 255]."""
    return np.clip(np.round(image), 0, 255).astype(np.uint8)
