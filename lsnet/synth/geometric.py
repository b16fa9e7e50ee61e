"""Geometric augmentation (Section III-A): zoom, rotation, flips, crops and new backgrounds.

Images are (H, W, 3), lines (K, 2) points x, y in pixels that may leave the image; the same map takes both.
Beyond an image all is of its mean colour: mirrored lines would be lines without labels. Cables with alpha are
(H, W, 4), nothing beyond.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Image = NDArray[np.float32]
    Points = NDArray[np.float64]
    Rng = np.random.Generator
    Labelled = tuple[Image, list[Points]]

CROPS = 5  # of each image, as in the paper
LEAST_CROP = 0.5  # side of a random crop, as a share of the image's


def affine(
    image: NDArray[np.uint8] | Image,
    lines: Sequence[Points],
    turn: Points,
    shift: Points,
    size: tuple[int, int],
) -> Labelled:
    """A float32 (height, width) image of `size`, in which p of the source lies at turn @ p + shift.

    Pixel centres are at i + 0.5, which OpenCV does not count in.
    """
    matrix = np.column_stack([turn, shift + turn @ np.array([0.5, 0.5]) - 0.5])
    beyond = [0.0] * 4 if image.shape[2] == 4 else image.mean(axis=(0, 1)).tolist()
    moved = cv2.warpAffine(image, matrix, size[::-1], flags=cv2.INTER_LINEAR, borderValue=beyond)
    return moved.astype(np.float32), [line @ turn.T + shift for line in lines]


def crop(image: Image, lines: Sequence[Points], rng: Rng) -> Labelled:
    """A random part, half to all of each side, in its own size."""
    height, width = image.shape[:2]
    share = rng.uniform(LEAST_CROP, 1)
    h, w = max(1, round(share * height)), max(1, round(share * width))
    y, x = int(rng.integers(height - h + 1)), int(rng.integers(width - w + 1))
    return image[y : y + h, x : x + w].copy(), [line - [x, y] for line in lines]


def zoom(image: Image, lines: Sequence[Points], rng: Rng) -> Labelled:
    """A random part scaled to the size of the whole: a camera that is nearer."""
    height, width = image.shape[:2]
    share = rng.uniform(LEAST_CROP, 1)
    corner = np.array([rng.uniform(0, (1 - share) * width), rng.uniform(0, (1 - share) * height)])
    return affine(image, lines, np.eye(2) / share, -corner / share, (height, width))


def rotate(image: Image, lines: Sequence[Points], rng: Rng) -> Labelled:
    """Turned about the centre by any angle."""
    angle, centre = rng.uniform(-np.pi, np.pi), np.array([image.shape[1], image.shape[0]]) / 2
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return affine(image, lines, turn, centre - turn @ centre, (image.shape[0], image.shape[1]))


def flip(image: Image, lines: Sequence[Points], rng: Rng) -> Labelled:
    """Mirrored horizontally, vertically, or both."""
    kind = int(rng.integers(1, 4))
    flipped = image[:: -1 if kind & 2 else 1, :: -1 if kind & 1 else 1].copy()
    sign = np.array([-1.0 if kind & 1 else 1.0, -1.0 if kind & 2 else 1.0])
    extent = np.array([image.shape[1] if kind & 1 else 0.0, image.shape[0] if kind & 2 else 0.0])
    return flipped, [line * sign + extent for line in lines]


def crops_and_flips(image: Image, lines: Sequence[Points], rng: Rng) -> list[Labelled]:
    """Before training: five random crops, each followed by a flipped version."""
    found: list[Labelled] = []
    for _ in range(CROPS):
        part = crop(image, lines, rng)
        found += [part, flip(*part, rng)]
    return found


def over(cables: Image, background: Image) -> Image:
    """(H, W, 3) of (H, W, 4) cables with alpha in [0, 1], not multiplied in, over a background."""
    alpha = cables[..., 3:]
    return alpha * cables[..., :3] + (1 - alpha) * background
