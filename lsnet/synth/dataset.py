"""Drawn training images without end: sample i of a seed is always the same image."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from lsnet.synth.augment import augment
from lsnet.synth.clutter import add_clutter
from lsnet.synth.scene import add_cables

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lsnet.synth.backgrounds import BackgroundPool

EMPTY_SHARE = 0.2  # of the images hold no cable


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """An image and its lines.

    image: uint8 (size, size, 3) RGB; lines: (K, 2) points x, y in pixels, they may leave the image.
    """

    image: NDArray[np.uint8]
    lines: list[NDArray[np.float64]]


@dataclass(frozen=True, slots=True, eq=False)
class SyntheticScenes:
    """Cables over backgrounds and clutter, augmented."""

    pool: BackgroundPool
    size: int = 384
    seed: int = 0

    def __getitem__(self, index: int) -> Sample:
        rng = np.random.default_rng([self.seed, index])
        scene = _to_uint8(self.pool.sample(rng, self.size))
        add_clutter(scene, rng, lambda: _to_uint8(self.pool.sample(rng, self.size)))
        image = scene.astype(np.float32)
        lines = add_cables(image, rng) if rng.random() >= EMPTY_SHARE else []
        image, lines = augment(image, lines, rng)
        return Sample(_to_uint8(image), lines)


def _to_uint8(image: NDArray[np.float32]) -> NDArray[np.uint8]:
    return np.clip(np.round(image), 0, 255).astype(np.uint8)
