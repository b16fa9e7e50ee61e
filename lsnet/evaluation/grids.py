"""Detection with some of the four grids only, as in the paper's ablation (Section IV)."""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING

import numpy as np

from lsnet.errors import LSNetError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lsnet.arrays import Floats32, ImageArray, Maps
    from lsnet.runtime.backend import Backend

GRIDS = {"M": (0, 0), "H": (0, 1), "V": (1, 0), "C": (1, 1)}  # first row and column in the interleaved map


class OnlyGrids:
    """A backend that reports nothing in the cells of the other grids.

    Args:
        backend: Runs the network.
        grids: Letters of the grids to use: main, horizontal, vertical, central.

    Raises:
        LSNetError: Another letter, or none.
    """

    def __init__(self, backend: Backend, grids: str) -> None:
        if not grids or not set(grids) <= set(GRIDS):
            raise LSNetError(f"no grids {grids!r}; give some of the letters {''.join(GRIDS)}")
        self._backend, self._grids = backend, grids
        self.name, self.precision, self.threads = backend.name, backend.precision, backend.threads
        self.n_calls, self.n_images = backend.n_calls, backend.n_images

    def run(self, images: Sequence[ImageArray]) -> list[Maps]:
        """Return the raw maps of each image, in order, with scores of zero in the cells of other grids."""
        return [(self._kept(scores), endpoints) for scores, endpoints in self._backend.run(images)]

    def _kept(self, scores: Floats32) -> Floats32:
        kept = np.zeros_like(scores)
        for row, column in (GRIDS[grid] for grid in self._grids):
            kept[row::2, column::2] = scores[row::2, column::2]
        return kept


class Remembered:
    """A backend that runs each image once, for detectors with different grids that share it."""

    def __init__(self, backend: Backend) -> None:
        self._backend = backend
        self._maps: dict[bytes, Maps] = {}
        self.name, self.precision, self.threads = backend.name, backend.precision, backend.threads
        self.n_calls, self.n_images = backend.n_calls, backend.n_images

    def run(self, images: Sequence[ImageArray]) -> list[Maps]:
        """Return the raw maps of each image, in order."""
        keys = [_key(image) for image in images]
        new = {key: image for key, image in zip(keys, images, strict=True) if key not in self._maps}
        self._maps.update(zip(new, self._backend.run(list(new.values())), strict=True))
        return [self._maps[key] for key in keys]


def _key(image: ImageArray) -> bytes:
    digest = hashlib.sha256(repr(image.shape).encode())
    digest.update(np.ascontiguousarray(image).tobytes())
    return digest.digest()
