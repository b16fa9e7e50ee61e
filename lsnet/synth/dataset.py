"""Synthetic training images without end: sample i of a seed is always the same image."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import cv2
import numpy as np

from lsnet.synth.drawing import Sample, draw_ground, draw_tower, draw_wires

if TYPE_CHECKING:
    from lsnet.synth.backgrounds import BackgroundPool

EMPTY_SHARE = 0.2  # of images have no cable
SMALL_SHARE = 0.25  # of images have a low resolution, enlarged two to four times as by `Detector`
TOWER_SHARE = 0.2  # of the others show a tower from near, whose wires end there
PHOTOGRAPH_SHARE = 0.3  # of the others are photographs near their own resolution, without clutter


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
        is_photograph = has_details and rng.random() < PHOTOGRAPH_SHARE
        scene = draw_ground(self.pool, rng, size, is_photograph=is_photograph, has_clutter=not is_photograph)
        if scene.shape[0] != size:
            scene = np.asarray(cv2.resize(scene, (size, size), interpolation=cv2.INTER_CUBIC), np.uint8)
        lines = draw_tower(scene, rng) if has_details and rng.random() < TOWER_SHARE else []
        return draw_wires(scene, lines, rng, 1 - EMPTY_SHARE)
