"""Recipes: how a network is trained, without the network and the data."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, slots=True)
class TrainConfig:
    """Recipe of one run.

    Attributes:
        preset: Name of the network.
        schedule: Learning rate after the warm-up: a cosine down to a hundredth, or constant.
        ema_decay: Of the averaged weights, which are validated and exported; 0 for no averaging.
        clip_norm: Largest norm of the gradients; None for no limit.
        patience: Validations without improvement before the run stops.
        device: auto (a GPU if torch can use one), cuda or cpu.
        data: Description of the training data.
    """

    preset: str = "fast"
    steps: int = 10_000
    batch_size: int = 8
    learning_rate: float = 2e-3
    schedule: Literal["cosine", "constant"] = "cosine"
    weight_decay: float = 0.01
    warmup_steps: int = 200
    ema_decay: float = 0.998
    clip_norm: float | None = 5.0
    validate_every: int = 500
    validation_images: int = 256
    patience: int = 12
    threads: int = 1
    workers: int = 1
    device: str = "auto"
    data: str = ""


RECIPES = {
    "default": TrainConfig(),
    # Section III-D: Adam of rate 1e-4 and moments 0.9 and 0.999 (torch's own), batches of 8, early stopping.
    "paper": TrainConfig(
        preset="paper",
        learning_rate=1e-4,
        schedule="constant",
        weight_decay=0.0,
        warmup_steps=0,
        ema_decay=0.0,
        clip_norm=None,
    ),
}
HOW_COMPUTED = ("threads", "workers", "device")  # may change while a run is interrupted


@dataclass(frozen=True, slots=True)
class TrainingProgress:
    """Report during training: mean losses since the last report, and those of a validation."""

    step: int
    steps: int
    loss: float
    classification: float
    regression: float
    images_per_s: float
    validation_loss: float | None = None
    validation_classification: float | None = None
    validation_regression: float | None = None


def learning_rate_at(step: int, config: TrainConfig) -> float:
    """Return the learning rate: linear warm-up, then constant or a cosine down to a hundredth."""
    if step < config.warmup_steps:
        return config.learning_rate * (step + 1) / config.warmup_steps
    if config.schedule == "constant":
        return config.learning_rate
    t = (step - config.warmup_steps) / max(1, config.steps - config.warmup_steps)
    return config.learning_rate * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * min(t, 1.0))))
