"""What else is proposed near each line: parallel neighbours, and lines across it as in lattice steel."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from lsnet.lines.strips import resample

if TYPE_CHECKING:
    from lsnet.arrays import Floats32, Indices, RealArray
    from lsnet.lines.proposals import Proposals

CELL_PX, DIRECTIONS = 24, 8  # of the histogram in which proposals are counted
_APART = (np.arange(DIRECTIONS) - np.arange(DIRECTIONS)[:, None]) % DIRECTIONS
PARALLEL = (_APART <= 1) | (_APART == DIRECTIONS - 1)  # directions that count as those of each direction
PLACE_PX = 8  # between the places of a line that are counted


def count_neighbours(proposals: Proposals) -> Floats32:
    """Return (C, 4) lengths of other proposals within a cell of each line, in sides of the 72 px window.

    In order: the mean over the line of parallel ones, the mean of others, the median of others, the median of
    parallel ones.
    """
    height, width = proposals.image_size
    rows, columns = int(height // CELL_PX) + 3, int(width // CELL_PX) + 3
    lines = [_bins(polyline, rows, columns) for polyline in proposals.polylines]
    counts = np.zeros((rows, columns, DIRECTIONS), np.float32)
    for cell, turn, step in lines:
        np.add.at(counts, (cell[:, 0], cell[:, 1], turn), step)
    near = cv2.boxFilter(counts, -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
    out = np.zeros((len(lines), 4), np.float32)
    for i, (cell, turn, step) in enumerate(lines):
        touches = (np.abs(cell[:, None] - cell) <= 1).all(axis=-1)
        own = touches.astype(np.float32) @ (np.eye(DIRECTIONS, dtype=np.float32)[turn] * step)
        others = np.maximum(near[cell[:, 0], cell[:, 1]] - own, 0)  # (P, DIRECTIONS)
        parallel = (others * PARALLEL[turn]).sum(axis=1)
        across = others.sum(axis=1) - parallel
        out[i] = parallel.mean(), across.mean(), *np.median([across, parallel], axis=1)
    return np.asarray(out / (3 * CELL_PX), np.float32)


def _bins(polyline: RealArray, rows: int, columns: int) -> tuple[Indices, Indices, float]:
    """Return (P, 2) cells and (P,) directions of the pieces of a line, and the length of a piece, px."""
    length = float(np.hypot(*np.diff(polyline, axis=0).T).sum())
    count = max(4, int(length / PLACE_PX))
    points = resample(polyline, count + 1)[0]
    middles, steps = (points[1:] + points[:-1]) / 2, np.diff(points, axis=0)
    cell = np.clip((middles[:, ::-1] // CELL_PX).astype(np.intp) + 1, 0, (rows - 1, columns - 1))
    angle = np.mod(np.arctan2(steps[:, 1], steps[:, 0]), np.pi)
    turn = np.mod((angle / np.pi * DIRECTIONS + 0.5).astype(np.intp), DIRECTIONS)
    return cell, turn, length / count
