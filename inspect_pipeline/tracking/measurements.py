"""The lines of a frame as measurements of the tracker: straight, relative to the centre of the image."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from inspect_pipeline.arrays import Floats


# Standard deviations of measured lines, as shares of the longer image side or in rad.
_OFFSET_STD, _ANGLE_STD = 4 / 1280, float(np.radians(0.7))
_END_STD = 4 / 1280  # of end points, which limits the angle of short lines
_MAX_OVERLAP = 0.2  # of a piece with the other pieces of its line


@dataclass(frozen=True, slots=True, eq=False)
class FrameLines:
    """N lines of a frame: end points in px from the image centre, and quantities derived from them."""

    ends: Floats  # (N, 2, 2)
    centres: Floats  # (N, 2)
    angles: Floats  # (N,) rad
    half_lengths: Floats  # (N,) px
    variances: Floats  # (N, 2) of angle and offset

    @classmethod
    def from_chords(cls, chords: Floats, image_size: tuple[int, int]) -> FrameLines:
        """Create from chords (N, 4) x1, y1, x2, y2 in px of an image of (height, width)."""
        height, width = image_size
        ends = np.asarray(chords, np.float64).reshape(-1, 2, 2) - (width / 2, height / 2)
        vectors, longer_px = ends[:, 1] - ends[:, 0], max(image_size)
        lengths = np.hypot(vectors[:, 0], vectors[:, 1])
        angle_std = np.maximum(_ANGLE_STD, _END_STD * longer_px / np.maximum(lengths, 1.0))
        offset_std = np.full(len(ends), _OFFSET_STD * longer_px)
        angles = np.arctan2(vectors[:, 1], vectors[:, 0])
        variances = np.column_stack((angle_std, offset_std)) ** 2
        return cls(ends, ends.mean(axis=1), angles, lengths / 2, variances)

    def merge(self, pieces: Sequence[int], direction: Floats) -> FrameLines:
        """Return one line from the first to the last end point of some pieces along `direction` (2,)."""
        if len(pieces) == 1:
            only = slice(pieces[0], pieces[0] + 1)
            return FrameLines(
                self.ends[only],
                self.centres[only],
                self.angles[only],
                self.half_lengths[only],
                self.variances[only],
            )
        ends = self.ends[pieces].reshape(-1, 2)
        along = ends @ direction
        ends = ends[[along.argmin(), along.argmax()]]
        (x, y), half_length = ends[1] - ends[0], np.hypot(*(ends[1] - ends[0])) / 2
        variances = self.variances[pieces].min(axis=0)
        return FrameLines(
            ends[None],
            ends.mean(axis=0)[None],
            np.array([np.arctan2(y, x)]),
            np.array([half_length]),
            variances[None],
        )


def wrap_half_turn(angles: Floats) -> Floats:
    """Map angles of undirected lines to -pi/2 <= angle < pi/2."""
    wrapped: Floats = (angles + np.pi / 2) % np.pi - np.pi / 2
    return wrapped


def extends_line(positions: Floats, pieces: list[int], i: int) -> bool:
    """Return whether line i lies before, after or between some pieces of a line.

    positions: (N, 2) positions of the end points of all lines along the direction of that line.
    """
    (low, *others_low), (high, *others_high) = (
        extreme(positions[[i, *pieces]], axis=1).tolist() for extreme in (np.min, np.max)
    )
    others = zip(others_low, others_high, strict=True)
    overlap_px = sum(max(0.0, min(high, end) - max(low, start)) for start, end in others)
    return bool(overlap_px <= _MAX_OVERLAP * (high - low))
