"""Primitives of all clutter: strokes, places, directions, noise.

Images are uint8 (H, W, 3) RGB and are painted in place. Strokes are anti-aliased, which OpenCV does on
integer images only; jagged edges would distinguish clutter from cables.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from lsnet.arrays import Floats, Floats32, ImageArray, RealArray, Rng


SHIFT = 4  # fractional bits of the coordinates given to OpenCV
SCALE = 1 << SHIFT
MIN_DETAILED_PX = 256  # in smaller pictures shadows and ragged edges look like thin wires


def stroke(image: ImageArray, points: RealArray, rgb: RealArray, width_px: float) -> None:
    """Draw an anti-aliased open polyline (K, 2)."""
    fixed = np.round((np.asarray(points) - 0.5) * SCALE).astype(np.int32)
    thickness = max(1, round(width_px))
    cv2.polylines(image, [fixed], False, rgb.tolist(), thickness, cv2.LINE_AA, SHIFT)


def put(image: ImageArray, values: RealArray) -> None:
    """Replace the image by values (H, W, 3), rounded and clipped to [0, 255]."""
    image[:] = np.clip(np.round(values), 0, 255)


def direction(angle: float) -> Floats:
    """Return the unit vector x, y of an angle in radians."""
    return np.array([np.cos(angle), np.sin(angle)])


def anywhere(image: ImageArray, rng: Rng, margin: float = 0.1) -> Floats:
    """Return a random point x, y in pixels, up to `margin` of the size outside the image."""
    height, width = image.shape[:2]
    return np.array([rng.uniform(-margin, 1 + margin) * width, rng.uniform(-margin, 1 + margin) * height])


def perspective(image: ImageArray, rng: Rng) -> Callable[[RealArray], Floats]:
    """Return a random map from a plane to the image: rotated, at any place, slightly foreshortened."""
    angle, centre = rng.uniform(0, 2 * np.pi), anywhere(image, rng, 0)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    squeeze = np.array([1.0, rng.uniform(0.4, 1.0)])
    vanish = rng.normal(0, 0.0004, 2)

    def place(points: RealArray) -> Floats:
        depth = np.maximum(1 + points @ vanish, 0.2)[:, None]
        out: Floats = (points / depth * squeeze) @ turn.T + centre
        return out

    return place


def smooth_noise(rng: Rng, size: tuple[int, int], pitch_px: float) -> Floats32:
    """Return (H, W) standard normal noise, smooth over `pitch_px`."""
    height, width = (int(n / pitch_px) + 2 for n in size)
    coarse = rng.standard_normal((height, width), dtype=np.float32)
    how = cv2.INTER_CUBIC if pitch_px > 1 else cv2.INTER_NEAREST
    return np.asarray(cv2.resize(coarse, size[::-1], interpolation=how), np.float32)
