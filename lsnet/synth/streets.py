"""Streets from above: poles, the wires between them in bundles, and the wires that end at houses.

Poles and cross-arms are background. Images are uint8 (H, W, 3) RGB and are painted in place.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from lsnet.synth.brush import direction, put, stroke
from lsnet.synth.cables import Arc, draw_cable

if TYPE_CHECKING:
    from collections.abc import Callable

    from lsnet.arrays import FloatImage, Floats, ImageArray, Points, Rng
    from lsnet.synth.cables import Finish

THINNEST_PX, WIDEST_PX = 2.0, 12.0


def add_street(image: ImageArray, rng: Rng, finish: Callable[[], Finish]) -> list[Points]:
    """Draw poles of a street with their wires; return the centrelines of the wires, pixels.

    Args:
        image: uint8 (H, W, 3), painted in place.
        rng: Random numbers.
        finish: Returns a random appearance of wires.
    """
    height, width = image.shape[:2]
    size = max(height, width)
    along = direction(rng.uniform(0, np.pi))
    across = np.array([-along[1], along[0]])
    lean = direction(rng.uniform(0, 2 * np.pi)) * rng.uniform(0.02, 0.2) * size
    middle = rng.uniform(0.15, 0.85, 2) * (width, height)
    span_px = rng.uniform(0.35, 1.3) * size
    feet = [middle + along * span_px * k + across * rng.normal(0, 0.02) * size for k in range(-2, 3)]
    tops = [foot + lean * rng.uniform(0.8, 1.2) for foot in feet]
    for foot, top in zip(feet, tops, strict=True):
        _pole(image, rng, foot, top, across)
    picture = image.astype(np.float32)
    wires: list[Points] = []
    for _ in range(int(rng.integers(1, 6))):
        wires += _run(picture, rng, tops, across, finish())
    for top in tops[1:-1]:
        for _ in range(int(rng.integers(0, 5))):
            end = top + direction(rng.uniform(0, 2 * np.pi)) * rng.uniform(0.1, 0.6) * size
            width_px = THINNEST_PX * (_width_px(rng, size) / THINNEST_PX) ** 0.5
            wires.append(_wire(picture, rng, _arc(top, end, rng.normal(0, 0.03)), width_px, finish()))
    put(image, picture)
    return wires


def _width_px(rng: Rng, size: int) -> float:
    widest = max(THINNEST_PX, min(WIDEST_PX, size / 45))
    return float(np.exp(rng.uniform(np.log(THINNEST_PX), np.log(widest))))


def _run(picture: FloatImage, rng: Rng, tops: list[Points], across: Floats, finish: Finish) -> list[Points]:
    """Draw one wire, or a few side by side, from pole to pole."""
    size = max(picture.shape[:2])
    width_px, place = _width_px(rng, size), rng.uniform(-0.035, 0.035) * size
    count = int(rng.choice([1, 2, 3], p=[0.6, 0.25, 0.15]))
    gap_px, sag = width_px * rng.uniform(1.6, 5), rng.normal(0, 0.02)
    wires = []
    for k in range(count):
        shift = across * (place + k * gap_px)
        for start, end in pairwise(tops):
            arc = _arc(start + shift, end + shift, sag * rng.uniform(0.8, 1.2))
            wires.append(_wire(picture, rng, arc, width_px, finish))
    return wires


def _wire(picture: FloatImage, rng: Rng, arc: Arc, width_px: float, finish: Finish) -> Points:
    """Draw a wire, somewhat thinner at its end; return its centreline."""
    draw_cable(picture, arc, (width_px, width_px * rng.uniform(0.8, 1)), finish)
    return arc.points(33)


def _arc(start: Points, end: Points, sag: float) -> Arc:
    """Return an arc between two points with a sag in shares of its length."""
    (x1, y1), (x2, y2) = start.tolist(), end.tolist()
    return Arc((x1, y1), (x2, y2), sag * float(np.hypot(x2 - x1, y2 - y1)))


def _pole(image: ImageArray, rng: Rng, foot: Points, top: Points, across: Floats) -> None:
    """Draw a pole, from its foot to its nearer top, and a cross-arm."""
    size = max(image.shape[:2])
    rgb = np.clip(rng.uniform(50, 200) * (1 + rng.normal(0, 0.06, 3)), 5, 250)
    width_px = rng.uniform(0.004, 0.015) * size
    stroke(image, np.stack([foot, top]), rgb, max(2.0, width_px))
    if rng.random() < 0.6:
        arm = across * rng.uniform(0.01, 0.045) * size
        stroke(image, np.stack([top - arm, top + arm]), rgb * rng.uniform(0.6, 1.1), max(1.0, width_px * 0.6))
