"""On-the-fly augmentation (Section III-A): one function per technique, each applied with probability 0.25.

Images are float32 (H, W, 3) RGB in [0, 255]; functions return a new image. `elastic` moves lines too and
returns both.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from lsnet.arrays import FloatImage, Points, Rng


PROBABILITY = 0.25  # alpha of the paper


def gaussian_noise(image: FloatImage, rng: Rng) -> FloatImage:
    """Add normal noise, f(i, j) = s(i, j) + n(i, j), grey or coloured."""
    channels = int(rng.choice([1, 3]))
    noise = rng.standard_normal((*image.shape[:2], channels), dtype=np.float32)
    return image + noise * np.float32(rng.uniform(2, 18))


def gaussian_blur(image: FloatImage, rng: Rng) -> FloatImage:
    """Blur as if out of focus."""
    return np.asarray(cv2.GaussianBlur(image, (0, 0), rng.uniform(0.4, 1.5)), np.float32)


def motion_blur(image: FloatImage, rng: Rng) -> FloatImage:
    """Blur as if the camera moved: average along a short stretch in a random direction."""
    length = int(rng.integers(3, 8))
    kernel = np.zeros((length, length), np.float32)
    angle = rng.uniform(0, np.pi)
    reach = (length - 1) / 2
    for t in np.linspace(-reach, reach, 4 * length):
        kernel[round(reach + t * np.sin(angle)), round(reach + t * np.cos(angle))] = 1
    return np.asarray(cv2.filter2D(image, -1, kernel / kernel.sum()), np.float32)


def brightness(image: FloatImage, rng: Rng) -> FloatImage:
    """Shift all values."""
    return image + np.float32(rng.uniform(-60, 60))


def contrast(image: FloatImage, rng: Rng) -> FloatImage:
    """Stretch about the mean."""
    mean = np.float32(image.mean())
    return (image - mean) * np.float32(np.exp(rng.uniform(-0.7, 0.45))) + mean


def saturation(image: FloatImage, rng: Rng) -> FloatImage:
    """Stretch about the grey of each pixel."""
    own: FloatImage = image.mean(axis=2, keepdims=True)
    return own + (image - own) * np.float32(rng.uniform(0.2, 1.8))


def hue(image: FloatImage, rng: Rng) -> FloatImage:
    """Rotate about the grey axis of the RGB cube."""
    angle = rng.uniform(-0.6, 0.6)
    cosine, sine = np.cos(angle), np.sin(angle)
    one_third, root = (1 - cosine) / 3, np.sqrt(1 / 3) * sine
    turn = np.full((3, 3), one_third) + np.eye(3) * cosine
    turn += root * np.array([[0, -1, 1], [1, 0, -1], [-1, 1, 0]])
    return np.asarray(image @ turn.T.astype(np.float32), np.float32)


def grey(image: FloatImage, _rng: Rng) -> FloatImage:
    """Remove colour; three equal channels."""
    luma = image @ np.array([0.299, 0.587, 0.114], np.float32)
    return np.repeat(luma[..., None], 3, axis=2)


def haze(image: FloatImage, rng: Rng) -> FloatImage:
    """Add light scattered in the air: a veil of one colour, denser to one side."""
    t = np.linspace(0, 1, image.shape[1], dtype=np.float32)[None, :, None]
    veil = np.float32(rng.uniform(0.1, 0.45)) * (t if rng.random() < 0.5 else 1 - t)
    return image + veil * (np.float32(rng.uniform(170, 235)) - image)


def jpeg(image: FloatImage, rng: Rng) -> FloatImage:
    """Compress as JPEG with quality 30 to 95."""
    rounded = np.clip(image, 0, 255).astype(np.uint8)
    _, data = cv2.imencode(".jpg", rounded, [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(30, 96))])
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), np.float32)


PHOTOMETRIC: tuple[Callable[[FloatImage, Rng], FloatImage], ...] = (
    haze,
    gaussian_blur,
    motion_blur,
    brightness,
    saturation,
    contrast,
    hue,
    grey,
    gaussian_noise,
    jpeg,
)


PAPER = (gaussian_blur, brightness, saturation, contrast, hue, grey, gaussian_noise)  # those of the paper


def elastic(image: FloatImage, lines: Sequence[Points], rng: Rng) -> tuple[FloatImage, list[Points]]:
    """Deform image and lines by displacement fields rand(-1, 1), smoothed by a Gaussian and scaled by alpha.

    A coarse field is enlarged instead of smoothed: the same spectrum at less cost. A pixel p of the result
    is sampled at p + D(p), so a point q of the source moves to the p with p + D(p) = q.
    """
    height, width = image.shape[:2]
    coarse = rng.uniform(-1, 1, (2, 6, 6)).astype(np.float32) * np.float32(rng.uniform(1, 6))
    dx, dy = (cv2.resize(c, (width, height), interpolation=cv2.INTER_CUBIC) for c in coarse)
    x = np.arange(width, dtype=np.float32) + dx
    y = np.arange(height, dtype=np.float32)[:, None] + dy
    moved = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    return np.asarray(moved, np.float32), [_pull_back(points, dx, dy) for points in lines]


def _pull_back(points: Points, dx: FloatImage, dy: FloatImage) -> Points:
    """Solve p + D(p) = q for each point q by fixed-point iteration; D is small and smooth."""
    height, width = dx.shape
    p = points.copy()
    for _ in range(8):
        column = np.clip(p[:, 0] - 0.5, 0, width - 1).astype(np.float32).reshape(-1, 1)
        row = np.clip(p[:, 1] - 0.5, 0, height - 1).astype(np.float32).reshape(-1, 1)
        shift = [cv2.remap(d, column, row, cv2.INTER_LINEAR).ravel() for d in (dx, dy)]
        p = points - np.stack(shift, axis=1)
    return p


def augment(
    image: FloatImage,
    lines: Sequence[Points],
    rng: Rng,
    techniques: Sequence[Callable[[FloatImage, Rng], FloatImage]] = PHOTOMETRIC,
) -> tuple[FloatImage, list[Points]]:
    """Apply `elastic` and each technique with probability 0.25, in the order from scene to file."""
    lines = list(lines)
    if rng.random() < PROBABILITY:
        image, lines = elastic(image, lines, rng)
    for technique in techniques:
        if rng.random() < PROBABILITY:
            image = technique(image, rng)
    return image, lines
