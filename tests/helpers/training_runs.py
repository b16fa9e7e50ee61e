"""Short trainings of tiny networks on a handful of drawn lines."""

from __future__ import annotations

import cv2
import numpy as np

from lsnet.network_config import LSNetConfig
from lsnet.synth.drawing import Sample
from lsnet.training.recipe import TrainConfig, TrainingProgress

QUICK = TrainConfig(
    preset="tiny",
    steps=12,
    batch_size=2,
    learning_rate=5e-3,
    warmup_steps=2,
    validate_every=4,
    validation_images=2,
    threads=1,
    workers=0,
)


THIN = LSNetConfig(stage_channels=(4, 4, 4, 4), head_channels=4, norm="batch")


class Strokes:
    """A few fixed images, each with one bright line on a dark ground."""

    size = 64

    def __init__(self, count: int = 4, seed: int = 0) -> None:
        self._count, self._seed, self.asked = count, seed, []

    def __getitem__(self, index: int) -> Sample:
        self.asked.append(index)
        rng = np.random.default_rng([self._seed, index % self._count])
        image, line = np.full((64, 64, 3), 40, np.uint8), rng.uniform(0, 64, (2, 2))
        cv2.line(image, *(tuple(p) for p in line.astype(int).tolist()), (220, 220, 220), 3)
        return Sample(image, [line])


def quiet(_progress: TrainingProgress) -> None:
    """Report nothing."""
