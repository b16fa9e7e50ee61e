"""Conditions of capture: low light, infrared, shadows of the cables on the ground.

As in `lsnet.synth.augment`, images are float32 (H, W, 3) RGB in [0, 255], and functions return a new one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from lsnet.synth.augment import PROBABILITY, augment, grey
from lsnet.synth.compression import video

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lsnet.arrays import FloatImage, Points, Rng


def low_light(image: FloatImage, rng: Rng) -> FloatImage:
    """Simulate low light: dark, with amplified shot noise."""
    light, gain = rng.uniform(0.02, 0.15), rng.uniform(1.5, 5)
    electrons = np.maximum(image, 0) * np.float32(light * 10)
    noise = rng.standard_normal(image.shape, dtype=np.float32)
    counted = electrons + noise * np.sqrt(electrons + 4)
    return np.asarray(counted * np.float32(gain / 10), np.float32)


def infrared(image: FloatImage, rng: Rng) -> FloatImage:
    """Simulate a thermal camera: one channel, warm or cold bright, soft, with column noise."""
    warm = grey(image, rng)
    if rng.random() < 0.5:
        warm = 255 - warm
    soft = cv2.GaussianBlur(warm, (0, 0), rng.uniform(0.6, 1.4))
    middle, contrast = rng.uniform(80, 170), rng.uniform(0.4, 0.9)
    columns = rng.standard_normal((1, image.shape[1], 1), dtype=np.float32) * np.float32(rng.uniform(0.5, 3))
    return np.asarray((soft - soft.mean()) * np.float32(contrast) + np.float32(middle) + columns, np.float32)


def cable_shadows(image: FloatImage, lines: Sequence[Points], rng: Rng) -> FloatImage:
    """Draw soft dark shadows, all shifted alike from the cables; call it before drawing the cables.

    Shadows are not lines, so there are no labels for them.
    """
    shift = rng.uniform(-0.3, 0.3, 2) * min(image.shape[:2])
    shade = np.zeros(image.shape[:2], np.float32)
    width_px, fixed = int(rng.integers(1, 5)), 16  # OpenCV draws in sixteenths of a pixel
    for line in lines:
        points = np.round((line + shift - 0.5) * fixed).astype(np.int32)
        cv2.polylines(shade, [points[:, None]], isClosed=False, color=1.0, thickness=width_px, shift=4)
    soft = cv2.GaussianBlur(shade, (0, 0), rng.uniform(0.7, 3))
    return image * (1 - np.float32(rng.uniform(0.2, 0.5)) * np.asarray(soft)[..., None])


def augment_further(image: FloatImage, lines: Sequence[Points], rng: Rng) -> tuple[FloatImage, list[Points]]:
    """Apply infrared or low light with probability 0.25, then `augment`, then a video codec with 0.25."""
    if rng.random() < PROBABILITY:
        technique = infrared if rng.random() < 0.5 else low_light
        image = technique(image, rng)
    image, lines = augment(image, lines, rng)
    return (video(image, rng) if rng.random() < PROBABILITY else image), lines
