"""Detection with some of the four grids left out, as in the paper's ablation (Section IV)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from lsnet.errors import LSNetError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from lsnet.arrays import Maps
    from lsnet.runtime import Backend

GRIDS = {"M": (0, 0), "H": (0, 1), "V": (1, 0), "C": (1, 1)}  # first row and column of every second one


class OnlyGrids:
    """A backend that says nothing in the cells of the grids left out.

    grids: letters of main, horizontal, vertical and central. Raises LSNetError for others.
    """

    def __init__(self, backend: Backend, grids: str) -> None:
        if not grids or not set(grids) <= set(GRIDS):
            raise LSNetError(f"no grids {grids!r}; give some of the letters {''.join(GRIDS)}")
        self._backend, self._grids = backend, grids
        self.name, self.precision, self.threads = backend.name, backend.precision, backend.threads

    def run(self, images: Sequence[NDArray[np.uint8]]) -> list[Maps]:
        """Raw maps of each image, in order, with scores of zero in the cells left out."""
        return [(self._kept(scores), endpoints) for scores, endpoints in self._backend.run(images)]

    def _kept(self, scores: NDArray[np.float32]) -> NDArray[np.float32]:
        kept = np.zeros_like(scores)
        for row, column in (GRIDS[grid] for grid in self._grids):
            kept[row::2, column::2] = scores[row::2, column::2]
        return kept
