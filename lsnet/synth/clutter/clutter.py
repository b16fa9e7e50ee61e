"""Objects that are mistaken for cables: branches, trunks, kerbs, walls, joints, fences, markings, furrows.

Each kind is painted into a uint8 (H, W, 3) RGB image in place, and is never labelled.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from lsnet.synth.clutter.borders import edging, half_plane, road_bend, roadside
from lsnet.synth.clutter.plants import branches, cracks, foliage, shrub, trunk
from lsnet.synth.clutter.structures import building, fence, furrows, markings, shadows, struts, tile_grid
from lsnet.synth.clutter.yards import boulevard, painted_lines, roof, wall

if TYPE_CHECKING:
    from collections.abc import Callable

    from lsnet.arrays import ImageArray, Rng


# In painting order, from the ground up, with the probability to paint each kind (once more).
KINDS: dict[Callable[[ImageArray, Rng], None], float] = {
    furrows: 0.08,
    roadside: 0.35,
    markings: 0.14,
    tile_grid: 0.18,
    cracks: 0.10,
    edging: 0.16,
    shadows: 0.22,
    building: 0.12,
    foliage: 0.22,
    fence: 0.08,
    trunk: 0.12,
    struts: 0.10,
    branches: 0.25,
    shrub: 0.42,
}
BEND_PROBABILITY = 0.2  # of lines along a bend, on any ground, and of more
# What lies in yards and streets without wires. Where there are wires they would be taken for such lines.
YARD_KINDS: dict[Callable[[ImageArray, Rng], None], float] = {
    boulevard: 0.05,
    painted_lines: 0.14,
    roof: 0.06,
    wall: 0.14,
}
BORDER_PROBABILITY = 0.5  # of another ground, and of one more


def add_bends(image: ImageArray, rng: Rng) -> None:
    """Paint lines along bends any number of times."""
    while rng.random() < BEND_PROBABILITY:
        road_bend(image, rng)


def add_yard(image: ImageArray, rng: Rng) -> None:
    """Paint walls, painted lines, roofs and boulevards any number of times."""
    for paint, probability in YARD_KINDS.items():
        while rng.random() < probability:
            paint(image, rng)


def add_clutter(image: ImageArray, rng: Rng, ground: Callable[[], ImageArray]) -> None:
    """Paint each kind any number of times; `ground` returns other backgrounds of the same size."""
    while rng.random() < BORDER_PROBABILITY:
        half_plane(image, rng, ground())
    for paint, probability in KINDS.items():
        while rng.random() < probability:
            paint(image, rng)
