"""What else is proposed near each line: parallel neighbours, and lines across it as in lattice steel."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from lsnet.lines.quantiles import group_quantiles

if TYPE_CHECKING:
    from lsnet.arrays import Floats, Floats32, Indices
    from lsnet.lines.polylines import Polylines

CELL_PX, DIRECTIONS = 24, 8  # of the histogram in which proposals are counted
_APART = (np.arange(DIRECTIONS) - np.arange(DIRECTIONS)[:, None]) % DIRECTIONS
# Directions that count as those of each.
PARALLEL = ((_APART <= 1) | (_APART == DIRECTIONS - 1)).astype(float)
PLACE_PX = 8  # between the places of a line that are counted


def count_neighbours(lines: Polylines, image_size: tuple[int, int]) -> Floats32:
    """Return (C, 4) lengths of other proposals within a cell of each line, in sides of the 72 px window.

    In order: the mean over the line of parallel ones, the mean of others, the median of others, the median of
    parallel ones.
    """
    rows, columns = (int(side // CELL_PX) + 3 for side in image_size)
    counts = np.maximum(4, (lines.lengths_px / PLACE_PX).astype(np.intp))
    line, cell, turn = _bins(lines, counts, rows, columns)
    step_px = (lines.lengths_px / counts)[line]
    place = (cell[:, 0] * columns + cell[:, 1]) * DIRECTIONS + turn
    total_px = np.bincount(place, step_px, rows * columns * DIRECTIONS).reshape(rows, columns, DIRECTIONS)
    near_px = cv2.boxFilter(total_px, -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)

    width = columns + 2  # of the keys: a cell has no neighbour beyond the border, nor in another line
    key = (line * (rows + 2) + cell[:, 0]) * width + cell[:, 1]
    keys, seen, which = np.unique(key, return_index=True, return_inverse=True)
    own_px = np.bincount(which * DIRECTIONS + turn, step_px, len(keys) * DIRECTIONS).astype(float)
    own_near_px = _sums_around(keys, own_px.reshape(-1, DIRECTIONS), width)
    others_px = np.maximum(near_px[cell[seen, 0], cell[seen, 1]] - own_near_px, 0)
    parallel_px = (others_px @ PARALLEL)[which, turn]
    across_px = others_px.sum(axis=1)[which] - parallel_px

    first = np.concatenate([[0], np.cumsum(counts)])
    means = [np.add.reduceat(values, first[:-1]) / counts for values in (parallel_px, across_px)]
    firsts = np.concatenate([first, first[-1] + first[1:]])
    medians = group_quantiles(np.concatenate([across_px, parallel_px]), firsts, [0.5]).reshape(2, -1)
    return (np.stack([*means, *medians], axis=1) / (3 * CELL_PX)).astype(np.float32)


def _sums_around(keys: Indices, values: Floats, width: int) -> Floats:
    """(U, V) sums of the values (U, V) of the cells with sorted keys (U,), each over the 3 x 3 around it."""
    sums = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
    centres = keys[:, None] + np.array([-width, 0, width])
    begin, end = np.searchsorted(keys, centres - 1), np.searchsorted(keys, centres + 1, side="right")
    out: Floats = (sums[end] - sums[begin]).sum(axis=1)
    return out


def _bins(lines: Polylines, counts: Indices, rows: int, columns: int) -> tuple[Indices, Indices, Indices]:
    """Return (N,) line, (N, 2) cell and (N,) direction of the pieces, `counts` (C,) of each line."""
    ends = counts + 1
    number = np.repeat(np.arange(len(counts)), ends)
    last = np.cumsum(ends) - 1
    of_line = np.arange(len(number)) - (last - counts)[number]
    points = lines.at(number, of_line * (lines.lengths_px / counts)[number])
    middles, steps = (points[1:] + points[:-1]) / 2, points[1:] - points[:-1]
    is_piece = np.ones(len(steps), bool)
    is_piece[last[:-1]] = False
    middles, steps = middles[is_piece], steps[is_piece]
    cell = np.clip((middles[:, ::-1] // CELL_PX).astype(np.intp) + 1, 0, (rows - 1, columns - 1))
    angle = np.mod(np.arctan2(steps[:, 1], steps[:, 0]), np.pi)
    turn = np.mod((angle / np.pi * DIRECTIONS + 0.5).astype(np.intp), DIRECTIONS)
    return number[:-1][is_piece], cell, turn
