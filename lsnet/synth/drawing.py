"""One scene: a ground and what lies on it, then a structure with its wires, other wires, and the capture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from lsnet.synth.clutter.clutter import add_bends, add_clutter
from lsnet.synth.conditions import augment_further
from lsnet.synth.scene import add_cables, finish_for
from lsnet.synth.streets import add_street
from lsnet.synth.towers import add_tower

if TYPE_CHECKING:
    from lsnet.arrays import Floats, Floats32, ImageArray, Points, Rng
    from lsnet.synth.backgrounds import BackgroundPool

CABLE_SHARE = 0.4  # of scenes with a tower or a street have other wires as well


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """An image and its lines.

    Attributes:
        image: uint8 (H, W, 3) RGB.
        lines: (K, 2) points x, y in pixels, which may be outside the image.
    """

    image: ImageArray
    lines: list[Floats]


def draw_ground(
    pool: BackgroundPool, rng: Rng, size: int, *, is_photograph: bool, has_clutter: bool
) -> ImageArray:
    """Draw a ground, some with lines along bends.

    Args:
        pool: Photographs.
        rng: Random numbers.
        size: Side in pixels; of a photograph that is too small for it, the most.
        is_photograph: Near its own resolution; else also drawn grounds, or a photograph at any scale.
        has_clutter: Whether drawn objects that are mistaken for wires lie on it.
    """
    scene = pool.photograph(rng, size) if is_photograph else to_uint8(pool.sample(rng, size))
    add_bends(scene, rng)
    if has_clutter:
        add_clutter(scene, rng, lambda: to_uint8(pool.sample(rng, scene.shape[0])))
    return scene


def draw_tower(scene: ImageArray, rng: Rng) -> list[Points]:
    """Draw a tower into a scene; return its wires."""
    return add_tower(scene, rng, finish_for(scene.astype(np.float32), rng))


def draw_street(scene: ImageArray, rng: Rng) -> list[Points]:
    """Draw the wires of a street into a scene, and return them."""
    ground = scene.astype(np.float32)
    return add_street(scene, rng, lambda: finish_for(ground, rng))


def draw_wires(scene: ImageArray, lines: list[Points], rng: Rng, share: float) -> Sample:
    """Draw wires across a share of the scenes, fewer where there are lines already, and augment."""
    image = scene.astype(np.float32)
    if rng.random() < (CABLE_SHARE if lines else share):
        lines = lines + add_cables(image, rng)
    image, lines = augment_further(image, lines, rng)
    return Sample(to_uint8(image), lines)


def to_uint8(image: Floats32) -> ImageArray:
    """Round and clip to [0, 255]."""
    return np.clip(np.round(image), 0, 255).astype(np.uint8)
