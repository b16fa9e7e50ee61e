"""Frames that are too large for memory in overlapping tiles, whose raw maps are joined before decoding.

Each position of the whole map is taken from one tile, so there are no seams and no duplicates. In that tile
the receptive field of the `fast` network does not reach the border, so the maps equal those of the image.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from lsnet.arrays import Maps

STRIDE_PX = 16
BEFORE_PX = 144  # a position of the map depends on the 135 px before the corner of its cell
OVERLAP_PX = BEFORE_PX + 144  # and on 151 px after it; the next one is 16 px away


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


def tiles_of(height: int, width: int, max_pixels: int) -> list[Tile]:
    """Return the tiles of an image whose sides are multiples of 16: of one size, with the fewest pixels.

    Args:
        height: Of the image, px.
        width: Of the image, px.
        max_pixels: Largest tile; an image of at most so many is one tile.
    """
    tile_height, tile_width = _tile_size(height, width, max_pixels)
    return [
        Tile((window_y, window_x), (taken_y, taken_x))
        for window_y, taken_y in _cuts(height, tile_height)
        for window_x, taken_x in _cuts(width, tile_width)
    ]


@lru_cache(maxsize=16)
def _tile_size(height: int, width: int, max_pixels: int) -> tuple[int, int]:
    """Height and width of the tiles; the smallest ones where none are small enough."""
    n_pixels = {
        (tall, wide): rows * columns * tall * wide
        for (rows, tall), (columns, wide) in product(_pieces(height), _pieces(width))
    }
    small = [size for size in n_pixels if size[0] * size[1] <= max_pixels]
    return min(small, key=n_pixels.__getitem__) if small else list(n_pixels)[-1]


def _pieces(side: int) -> list[tuple[int, int]]:
    """Numbers of pieces that a side may be cut into, and their length, a multiple of 16."""
    lengths = [(1, side)]
    for number in range(2, side // OVERLAP_PX):
        length = -(-(side + (number - 1) * OVERLAP_PX) // number)
        lengths.append((number, length + -length % STRIDE_PX))
    return lengths


def _cuts(side: int, length: int) -> Iterator[tuple[slice, slice]]:
    """Windows of a length along one side with the map positions taken from each; each position once."""
    starts = [*range(0, side - length, max(length - OVERLAP_PX, 1)), side - length]
    first = 0
    for start, following in zip(starts, [*starts[1:], None], strict=True):
        last = side // STRIDE_PX - 1 if following is None else (following + BEFORE_PX) // STRIDE_PX
        yield slice(start, start + length), slice(first, last)
        first = last


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
