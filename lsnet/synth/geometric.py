"""Geometric augmentation (Section III-A): zoom, rotation, flips, crops and new backgrounds.

Images are (H, W, 3), lines (K, 2) points x, y in pixels that may be outside the image; both are mapped alike.
Beyond its border an image is filled with its mean colour, since mirrored lines would be lines without labels.
Cables with alpha are (H, W, 4) and transparent beyond.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lsnet.arrays import FloatImage, ImageArray, Points, Rng

    Labelled = tuple[FloatImage, list[Points]]

CROPS = 5  # per image, as in the paper
MIN_CROP = 0.5  # side of a random crop, as a share of the image's


def affine(
    image: ImageArray | FloatImage,
    lines: Sequence[Points],
    turn: Points,
    shift: Points,
    size: tuple[int, int],
) -> Labelled:
    """Map point p of an image and its lines to turn @ p + shift in a float32 image of (height, width) `size`.

    Pixel centres are at i + 0.5; in OpenCV they are at i.
    """
    matrix = np.column_stack([turn, shift + turn @ np.array([0.5, 0.5]) - 0.5])
    beyond = [0.0] * 4 if image.shape[2] == 4 else image.mean(axis=(0, 1)).tolist()
    moved = cv2.warpAffine(image, matrix, size[::-1], flags=cv2.INTER_LINEAR, borderValue=beyond)
    return moved.astype(np.float32), [line @ turn.T + shift for line in lines]


def crop(image: FloatImage, lines: Sequence[Points], rng: Rng) -> Labelled:
    """Crop a random part, half to all of each side, without scaling."""
    height, width = image.shape[:2]
    share = rng.uniform(MIN_CROP, 1)
    h, w = max(1, round(share * height)), max(1, round(share * width))
    y, x = int(rng.integers(height - h + 1)), int(rng.integers(width - w + 1))
    return image[y : y + h, x : x + w].copy(), [line - [x, y] for line in lines]


def zoom(image: FloatImage, lines: Sequence[Points], rng: Rng) -> Labelled:
    """Scale a random part to the size of the whole, as if the camera were nearer."""
    height, width = image.shape[:2]
    share = rng.uniform(MIN_CROP, 1)
    corner = np.array([rng.uniform(0, (1 - share) * width), rng.uniform(0, (1 - share) * height)])
    return affine(image, lines, np.eye(2) / share, -corner / share, (height, width))


def rotate(image: FloatImage, lines: Sequence[Points], rng: Rng) -> Labelled:
    """Rotate about the centre by a random angle."""
    angle, centre = rng.uniform(-np.pi, np.pi), np.array([image.shape[1], image.shape[0]]) / 2
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return affine(image, lines, turn, centre - turn @ centre, (image.shape[0], image.shape[1]))


def flip(image: FloatImage, lines: Sequence[Points], rng: Rng) -> Labelled:
    """Mirror horizontally, vertically, or both."""
    kind = int(rng.integers(1, 4))
    flipped = image[:: -1 if kind & 2 else 1, :: -1 if kind & 1 else 1].copy()
    sign = np.array([-1.0 if kind & 1 else 1.0, -1.0 if kind & 2 else 1.0])
    extent = np.array([image.shape[1] if kind & 1 else 0.0, image.shape[0] if kind & 2 else 0.0])
    return flipped, [line * sign + extent for line in lines]


def crops_and_flips(image: FloatImage, lines: Sequence[Points], rng: Rng) -> list[Labelled]:
    """Return five random crops, each followed by a flipped version (offline augmentation of the paper)."""
    found: list[Labelled] = []
    for _ in range(CROPS):
        part = crop(image, lines, rng)
        found += [part, flip(*part, rng)]
    return found


def over(cables: FloatImage, background: FloatImage) -> FloatImage:
    """Compose (H, W, 4) cables, with straight alpha in [0, 1], over a background (H, W, 3)."""
    alpha = cables[..., 3:]
    return alpha * cables[..., :3] + (1 - alpha) * background
