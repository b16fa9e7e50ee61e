"""What is mistaken for cables and is none: branches, trunks, kerbs, joints, fences, markings, furrows.

Each kind paints onto a uint8 (H, W, 3) RGB image in place; none of it is ever labelled.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from lsnet.synth.clutter.borders import edging, half_plane, roadside
from lsnet.synth.clutter.plants import branches, cracks, foliage, shrub, trunk
from lsnet.synth.clutter.structures import building, fence, furrows, markings, shadows, struts, tile_grid

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np
    from numpy.typing import NDArray

    Image = NDArray[np.uint8]
    Rng = np.random.Generator

# In the order of painting, from the ground up; how likely each kind is to be painted (again).
KINDS: dict[Callable[[Image, Rng], None], float] = {
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
BORDER_PROBABILITY = 0.5  # of another ground, again and again


def add_clutter(image: Image, rng: Rng, ground: Callable[[], Image]) -> None:
    """Paint each kind none, one or several times; `ground` gives other backgrounds of the same size."""
    while rng.random() < BORDER_PROBABILITY:
        half_plane(image, rng, ground())
    for paint, probability in KINDS.items():
        while rng.random() < probability:
            paint(image, rng)
