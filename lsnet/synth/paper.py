"""Training images as the paper makes them (Sections III-A and III-D), without what was added to them here."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from lsnet.synth.augment import PAPER, augment
from lsnet.synth.drawing import Sample, to_uint8
from lsnet.synth.pbr.scenes import composed, cropped
from lsnet.synth.scene import add_cables

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from lsnet.synth.backgrounds import BackgroundPool


@dataclass(frozen=True, slots=True, eq=False)
class PaperScenes:
    """Cables over photographs, with noise, blur, colour manipulations and elastic deformation only.

    Of rendered pictures, five crops and their flips, each over five backgrounds; without any, cables are
    drawn. There is no clutter, haze, motion blur or compression.

    Attributes:
        pictures: Truths of rendered pictures, as from `rendered_pictures`; empty for drawn cables.
    """

    pool: BackgroundPool
    size: int = 512
    seed: int = 0
    pictures: Sequence[Path] = ()

    def __getitem__(self, index: int) -> Sample:
        rng = np.random.default_rng([self.seed, index])
        image = self.pool.sample(rng, self.size)
        if self.pictures:
            cables, lines = cropped(self.pictures, index, self.size, self.seed)
            image = composed(cables, image)
        else:
            lines = add_cables(image, rng)
        image, lines = augment(image, lines, rng, PAPER)
        return Sample(to_uint8(image), lines)
