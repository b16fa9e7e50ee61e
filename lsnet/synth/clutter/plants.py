"""Bare trees, shrubs, trunks, leaves, cracks and vines."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from lsnet.synth.brush import SCALE, SHIFT, anywhere, direction, stroke

if TYPE_CHECKING:
    from lsnet.arrays import ImageArray, RealArray, Rng


def branches(image: ImageArray, rng: Rng) -> None:
    """Draw a bare tree: a tapering, crooked trunk that forks into twigs."""
    rgb = np.clip(rng.choice([35, 80, 120, 175]) + rng.normal(0, 12) + np.array([10, 0, -12]), 0, 255)
    straightness = rng.uniform(0.05, 0.35)
    limit = int(rng.integers(60, 260))
    stack = [(anywhere(image, rng, 0.2), rng.uniform(0, 2 * np.pi), rng.uniform(50, 200), rng.uniform(2, 16))]
    drawn = 0
    while stack and drawn < limit:
        start, angle, length, width = stack.pop(0)
        steps = max(3, int(length / 14))
        turns = angle + np.cumsum(rng.normal(0, straightness, steps))
        path = start + np.cumsum(np.stack([np.cos(turns), np.sin(turns)], 1) * length / steps, axis=0)
        path = np.vstack([start, path])
        tone = np.clip(rgb * rng.uniform(0.75, 1.25), 0, 255)
        half = len(path) // 2
        stroke(image, path[: half + 1], tone, width)
        stroke(image, path[half:], tone, width * 0.75)
        drawn += 1
        if length < 14 or width < 0.6:
            continue
        for _ in range(int(rng.integers(2, 5))):
            at = int(rng.integers(steps // 3, steps + 1))
            fork = turns[min(at, steps - 1)] + rng.choice([-1, 1]) * rng.uniform(0.25, 1.0)
            stack.append((path[at], fork, length * rng.uniform(0.45, 0.8), width * rng.uniform(0.45, 0.75)))


def shrub(image: ImageArray, rng: Rng) -> None:
    """Draw long thin twigs, nearly straight, in a fan from one root, some of them forked."""
    root, heading = anywhere(image, rng, 0.15), rng.uniform(0, 2 * np.pi)
    rgb = np.clip(rng.choice([30, 70, 110, 160, 200]) + rng.normal(0, 12) + np.array([10, 0, -12]), 0, 255)
    fan, reach, width = rng.uniform(0.15, 0.9), rng.uniform(60, 320), rng.uniform(1.2, 7)
    for _ in range(int(rng.integers(3, 28))):
        at = root + rng.normal(0, reach * 0.06, 2)
        course = (heading + rng.normal(0, fan), reach * rng.uniform(0.3, 1.0))
        tone = np.clip(rgb * rng.uniform(0.7, 1.3), 0, 255)
        _twig(image, rng, at, course, rgb=tone, width=width * rng.uniform(0.4, 1))


def _twig(
    image: ImageArray,
    rng: Rng,
    at: RealArray,
    course: tuple[float, float],
    *,
    rgb: RealArray,
    width: float,
) -> None:
    """Draw a tapering twig with its forks; `course` is its first direction and its length."""
    angle, length = course
    turns = angle + np.cumsum(rng.normal(0, rng.uniform(0.01, 0.09), 12))
    path = np.vstack([at, at + np.cumsum(np.stack([np.cos(turns), np.sin(turns)], 1) * length / 12, axis=0)])
    for part, taper in ((path[:6], 1.0), (path[5:10], 0.7), (path[9:], 0.4)):
        stroke(image, part, rgb, width * taper)
    if length > 50:
        for _ in range(int(rng.integers(0, 4))):
            k = int(rng.integers(3, 11))
            fork = (turns[k] + rng.choice([-1, 1]) * rng.uniform(0.2, 0.9), length * 0.4)
            _twig(image, rng, path[k], fork, rgb=rgb, width=width * 0.5)


def trunk(image: ImageArray, rng: Rng) -> None:
    """Draw a pole, pipe or trunk: a shaded band too wide for a cable."""
    start, angle = anywhere(image, rng), rng.uniform(0, 2 * np.pi)
    width = rng.uniform(20, 60)
    end = start + direction(angle) * rng.uniform(0.3, 2.0) * max(image.shape[:2])
    rgb = np.clip(rng.uniform(30, 220) + rng.normal(0, 12, 3), 0, 255)
    side = direction(angle + np.pi / 2)
    light = rng.uniform(-0.8, 0.8)
    for s in np.linspace(-1, 1, 9):
        tone = rgb * (0.55 + 0.6 * max(0.0, 1 - abs(s - light)))
        offset = side * s * width / 2
        stroke(image, np.stack([start + offset, end + offset]), np.clip(tone, 0, 255), width / 8 + 2)


def cracks(image: ImageArray, rng: Rng) -> None:
    """Draw crooked thin lines: cracks, paths, vines, edges of shadows."""
    for _ in range(int(rng.integers(1, 6))):
        steps, step = int(rng.integers(8, 40)), rng.uniform(6, 18)
        turns = rng.uniform(0, 2 * np.pi) + np.cumsum(rng.normal(0, rng.uniform(0.2, 0.6), steps))
        path = anywhere(image, rng) + np.cumsum(np.stack([np.cos(turns), np.sin(turns)], 1) * step, axis=0)
        stroke(image, path, np.clip(rng.uniform(0, 255) + rng.normal(0, 10, 3), 0, 255), rng.uniform(1, 4))


def foliage(image: ImageArray, rng: Rng) -> None:
    """Draw leaves: many small blobs of one hue, lit and in shade, over a patch or everywhere."""
    height, width = image.shape[:2]
    is_dense = rng.random() < 0.45
    count, size = 2500 if is_dense else int(rng.integers(150, 900)), rng.uniform(1.5, 6)
    hue = np.array([rng.uniform(50, 150), rng.uniform(60, 160), rng.uniform(20, 90)])
    centre, spread = anywhere(image, rng, 0), rng.uniform(0.15, 0.8) * max(height, width)
    places = centre + rng.normal(0, spread / 2, (count, 2))
    if is_dense:
        places = rng.uniform(-5, 5, (count, 2)) + rng.uniform(0, 1, (count, 2)) * [width, height]
    tones = np.clip(hue * rng.gamma(rng.uniform(1.5, 4), 0.3, (count, 1)), 0, 255)
    axes, angles = rng.uniform(0.4, 1.6, (count, 2)) * size, rng.uniform(0, 180, count)
    for place, tone, axis, angle in zip(places, tones, axes, angles, strict=True):
        centre_fixed = (int(place[0] * SCALE), int(place[1] * SCALE))
        axes_fixed = (int(axis[0] * SCALE), int(axis[1] * SCALE))
        cv2.ellipse(image, centre_fixed, axes_fixed, angle, 0, 360, tone.tolist(), -1, cv2.LINE_AA, SHIFT)
