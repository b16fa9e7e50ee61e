"""Cells of each grid have their corners where the paper places them."""

from __future__ import annotations

import numpy as np
import pytest

from lsnet import LSNetError
from lsnet.evaluation.grids import OnlyGrids, Remembered
from lsnet.grid import GridCoder


class AllCells:
    name, precision, threads, n_calls, n_images = "fake", "f32", 1, 1, 1

    def run(self, images: list[np.ndarray]) -> list[tuple[np.ndarray, np.ndarray]]:
        rows, columns = GridCoder().map_size(images[0].shape[:2])
        return [(np.ones((rows, columns), np.float32), np.zeros((rows, columns, 4), np.float32))]


@pytest.mark.parametrize(
    ("grids", "offsets"), [("M", [(0, 0)]), ("MH", [(0, 0), (16, 0)]), ("VC", [(0, 16), (16, 16)])]
)
def test_cells_are_those_of_the_grids_shifted_by_half_a_cell(
    grids: str, offsets: list[tuple[int, int]]
) -> None:
    backend = OnlyGrids(AllCells(), grids)
    ((scores, _),) = backend.run([np.zeros((96, 128, 3), np.uint8)])
    corners = GridCoder().corners((96, 128))[scores > 0]
    expected = {(x, y) for dx, dy in offsets for x in range(dx, 128 - 31, 32) for y in range(dy, 96 - 31, 32)}
    assert set(map(tuple, corners.tolist())) == expected
    assert (backend.name, backend.precision, backend.threads) == ("fake", "f32", 1)


@pytest.mark.parametrize("grids", ["", "MX", "m"])
def test_unknown_grid_letters_are_one_line(grids: str) -> None:
    with pytest.raises(LSNetError, match="give some of the letters MHVC"):
        OnlyGrids(AllCells(), grids)


def test_each_image_is_run_once_for_all_grids() -> None:
    class Counted(AllCells):
        n_run = 0

        def run(self, images: list[np.ndarray]) -> list[tuple[np.ndarray, np.ndarray]]:
            self.n_run += len(images)
            return [pair for image in images for pair in super(Counted, self).run([image])]

    counted = Counted()
    shared = Remembered(counted)
    black, wide = np.zeros((96, 128, 3), np.uint8), np.zeros((128, 96, 3), np.uint8)
    images = [black, black + 1, wide]
    shapes = [[scores.shape for scores, _ in OnlyGrids(shared, grids).run(images)] for grids in ("M", "MHVC")]
    assert shapes == [[(5, 7), (5, 7), (7, 5)]] * 2
    assert counted.n_run == 3
