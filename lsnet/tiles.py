"""Large images in overlapping tiles whose raw maps are joined before decoding.

Each position of the whole map is taken from one tile, so there are no seams and no duplicates. In that tile
the receptive field of the `fast` network does not reach the border, so the maps equal those of the image.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from lsnet.arrays import Maps

TILE_PX = 1024  # longest side that is run in one piece
MARGIN_PX = 144  # not taken at a tile's border: 128 px of receptive field about a cell, and one step
STRIDE_PX = 16


@dataclass(frozen=True, slots=True)
class Tile:
    """A window of the image, pixels, and the rows and columns of the whole map that are taken from it."""

    window: tuple[slice, slice]
    taken: tuple[slice, slice]

    def inner(self) -> tuple[slice, slice]:
        """Return `taken` in positions of the tile's own map."""
        return tuple(  # type: ignore[return-value]
            slice(t.start - w.start // STRIDE_PX, t.stop - w.start // STRIDE_PX)
            for t, w in zip(self.taken, self.window, strict=True)
        )


def tiles_of(height: int, width: int) -> list[Tile]:
    """Return the tiles of an image whose sides are multiples of 16; one tile if it is small."""
    return [
        Tile((window_y, window_x), (taken_y, taken_x))
        for window_y, taken_y in _cuts(height)
        for window_x, taken_x in _cuts(width)
    ]


def _cuts(side: int) -> Iterator[tuple[slice, slice]]:
    """Windows along one side with the map positions taken from each; each position once."""
    positions = side // STRIDE_PX - 1
    if side <= TILE_PX:
        yield slice(0, side), slice(0, positions)
        return
    step = TILE_PX - 2 * MARGIN_PX
    count = -(-(side - 2 * MARGIN_PX) // step)
    starts = [min(i * step, side - TILE_PX) for i in range(count)]
    for i, start in enumerate(starts):
        first = 0 if i == 0 else (start + MARGIN_PX) // STRIDE_PX
        last = positions if i == count - 1 else (starts[i + 1] + MARGIN_PX) // STRIDE_PX
        yield slice(start, start + TILE_PX), slice(first, last)


def join(height: int, width: int, tiles: Sequence[Tile], maps: Sequence[Maps]) -> Maps:
    """Return the maps of a whole image from those of its tiles."""
    if len(tiles) == 1:
        return maps[0]
    scores = np.empty((height // STRIDE_PX - 1, width // STRIDE_PX - 1), np.float32)
    endpoints = np.empty((*scores.shape, 4), np.float32)
    for tile, (tile_scores, tile_endpoints) in zip(tiles, maps, strict=True):
        scores[tile.taken] = tile_scores[tile.inner()]
        endpoints[tile.taken] = tile_endpoints[tile.inner()]
    return scores, endpoints
