"""The four overlapping grids of the paper (Section III-B) as one interleaved map.

Cells are `cell_px` wide squares. The main grid tiles the image; the horizontal, vertical and central
grids are the same shifted by half a cell in x, in y, and in both. Interleaved, they are one map with a
step of half a cell: position (row, column) is the cell whose top-left corner is
(column, row) * cell_px / 2, and an image of (h, w) has (2 h / cell_px - 1, 2 w / cell_px - 1) positions,
31 x 31 at 512 x 512 with cells of 32 px. Even row and column: main grid; odd column: horizontal;
odd row: vertical; both odd: central.

A cell reports its longest segment, both endpoints as fractions of the cell: (0, 0) is its top-left corner.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from lsnet.geometry import clip_to_boxes
from lsnet.segments import Segments

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from lsnet.arrays import Floats, Floats32, RealArray

NEGATIVE, POSITIVE, IGNORED = 0, 1, -1
OFF_CENTRE_PENALTY = (
    0.25  # default of `GridCoder`: keeps the choice among parallel lines from being arbitrary
)


@dataclass(frozen=True, slots=True, eq=False)
class Targets:
    """What the network should predict for one image.

    Attributes:
        labels: (R, C) int8, POSITIVE, NEGATIVE or IGNORED.
        endpoints: (R, C, 4) float32 in cell fractions, zero where the label is not POSITIVE.
    """

    labels: NDArray[np.int8]
    endpoints: Floats32


@dataclass(frozen=True, slots=True)
class GridCoder:
    """Convert polylines to targets and network maps to segments; `encode` and `decode` are inverse.

    Attributes:
        cell_px: Side of a cell.
        min_chord: Shortest chord, as a fraction of the cell, that makes a cell positive. Shorter ones are
            ignored in training, since another of the four grids has a long chord of the same stretch.
        off_centre_penalty: A chord's length counts less by this much per pixel from the cell's centre; with
            0, as in the paper, strictly the longest chord counts.
    """

    cell_px: int = 32
    min_chord: float = 0.25
    off_centre_penalty: float = OFF_CENTRE_PENALTY

    @property
    def stride_px(self) -> int:
        """Distance of neighbouring positions of the interleaved map, px."""
        return self.cell_px // 2

    def map_size(self, image_size: tuple[int, int]) -> tuple[int, int]:
        """Return (rows, columns) of the interleaved map of an image of (height, width)."""
        return image_size[0] // self.stride_px - 1, image_size[1] // self.stride_px - 1

    def corners(self, image_size: tuple[int, int]) -> Floats32:
        """Return (R, C, 2) x, y of the top-left corner of each cell, pixels."""
        rows, columns = self.map_size(image_size)
        y, x = np.mgrid[:rows, :columns].astype(np.float32) * self.stride_px
        return np.stack([x, y], axis=-1)

    def encode(self, polylines: Sequence[RealArray], image_size: tuple[int, int]) -> Targets:
        """Return the targets of an image of (height, width) with polylines (K, 2) in pixels.

        The chord of a line in a cell goes from where the line first enters the cell to where it last leaves
        it. The longest chord in a cell counts. Among chords of similar length, as of parallel lines, the one
        nearer to the middle of the cell does, so that the target is not arbitrary.
        """
        corners = self.corners(image_size)
        best, longest = np.full(corners.shape[:2], -np.inf), np.zeros(corners.shape[:2])
        endpoints = np.zeros((*corners.shape[:2], 4))
        boxes = np.concatenate([corners, corners + self.cell_px], axis=-1)
        for points in polylines:
            chords = _chords(np.asarray(points, float), boxes)
            lengths = np.hypot(chords[..., 2] - chords[..., 0], chords[..., 3] - chords[..., 1])
            weights = lengths - self.off_centre_penalty * _off_centre(chords, corners + self.cell_px / 2)
            weights += (
                (lengths >= self.min_chord * self.cell_px) * 2 * self.cell_px
            )  # long ones before short ones
            is_better = (lengths > 0) & (weights > best)
            best = np.where(is_better, weights, best)
            longest = np.maximum(longest, lengths)
            endpoints[is_better] = chords[is_better]
        labels = np.where(longest >= self.min_chord * self.cell_px, POSITIVE, IGNORED)
        labels[longest <= 0] = NEGATIVE
        fractions = (endpoints - np.tile(corners, 2)) / self.cell_px
        fractions[labels != POSITIVE] = 0
        return Targets(labels.astype(np.int8), fractions.astype(np.float32))

    def decode(
        self,
        scores: RealArray,
        endpoints: RealArray,
        image_size: tuple[int, int],
        min_score: float,
    ) -> Segments:
        """Return the segments, in pixels, of maps: scores (R, C) and endpoints (R, C, 4) in cell fractions.

        Endpoints outside their cell are moved to its border. A line along the edge between two cells of one
        grid is reported by both; nothing is merged here.
        """
        keep = scores >= min_score
        rows, columns = np.nonzero(keep)
        corners = np.stack([columns, rows, columns, rows], axis=1) * np.float32(self.stride_px)
        absolute = np.clip(endpoints[keep], 0.0, 1.0) * self.cell_px + corners
        return Segments(absolute.astype(np.float32), scores[keep].astype(np.float32), image_size)


def _chords(points: RealArray, boxes: RealArray) -> Floats:
    """(R, C, 4) chords of one polyline (K, 2) in the boxes (R, C, 4), zeros where it misses the box."""
    pieces = np.concatenate([points[:-1], points[1:]], axis=1)
    t_in, t_out = clip_to_boxes(pieces, boxes[:, :, None])  # (R, C, K - 1)
    is_hit = t_out > t_in
    first = np.argmax(is_hit, axis=-1)
    last = is_hit.shape[-1] - 1 - np.argmax(is_hit[..., ::-1], axis=-1)
    start = _along(pieces[first], np.take_along_axis(t_in, first[..., None], -1))
    end = _along(pieces[last], np.take_along_axis(t_out, last[..., None], -1))
    chords = np.concatenate([start, end], axis=-1)
    return np.where(is_hit.any(axis=-1, keepdims=True), chords, 0.0)


def _off_centre(chords: Floats, centres: RealArray) -> Floats:
    """(R, C) distances of the centres of cells from the middles of their chords."""
    middles = (chords[..., :2] + chords[..., 2:]) / 2 - centres
    return np.hypot(middles[..., 0], middles[..., 1])


def _along(pieces: RealArray, t: RealArray) -> RealArray:
    return pieces[..., :2] * (1 - t) + pieces[..., 2:] * t
