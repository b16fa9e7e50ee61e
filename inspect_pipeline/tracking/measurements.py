"""The lines of a frame as `tracks` measures them: straight, from the middle of the image."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from inspect_pipeline.arrays import Floats


# As shares of the longer side of the image, or in rad: how well lines are measured.
_ASIDE_NOISE, _ANGLE_NOISE = 4 / 1280, float(np.radians(0.7))
_END_NOISE = 4 / 1280  # of the ends, which turns short lines
_OVERLAP_SHARE = 0.2  # of a piece, at most, lies beside the other pieces


@dataclass(frozen=True, slots=True, eq=False)
class FrameLines:
    """The lines of a frame: ends (N, 2, 2) px from the middle of the image, and what follows from them."""

    ends: Floats
    middles: Floats  # (N, 2)
    angles: Floats  # (N,) rad
    halves: Floats  # (N,) px, of the length
    noise: Floats  # (N, 2) variances of angle and distance aside

    @classmethod
    def of(cls, chords: Floats, image_size: tuple[int, int]) -> FrameLines:
        """The lines of (N, 4) chords x1, y1, x2, y2 in px of an image of (height, width)."""
        height, width = image_size
        ends = np.asarray(chords, np.float64).reshape(-1, 2, 2) - (width / 2, height / 2)
        along, longer_px = ends[:, 1] - ends[:, 0], max(image_size)
        lengths = np.hypot(along[:, 0], along[:, 1])
        turned = np.maximum(_ANGLE_NOISE, _END_NOISE * longer_px / np.maximum(lengths, 1.0))
        aside = np.full(len(ends), _ASIDE_NOISE * longer_px)
        angles = np.arctan2(along[:, 1], along[:, 0])
        return cls(ends, ends.mean(axis=1), angles, lengths / 2, np.column_stack((turned, aside)) ** 2)

    def joined(self, pieces: Sequence[int], direction: Floats) -> FrameLines:
        """The one line from the first to the last end of some pieces along a direction."""
        ends = self.ends[pieces].reshape(-1, 2)
        along = ends @ direction
        ends = ends[[along.argmin(), along.argmax()]]
        (x, y), half = ends[1] - ends[0], np.hypot(*(ends[1] - ends[0])) / 2
        noise = self.noise[pieces].min(axis=0)
        return FrameLines(
            ends[None], ends.mean(axis=0)[None], np.array([np.arctan2(y, x)]), np.array([half]), noise[None]
        )


def half_turned(angles: Floats) -> Floats:
    """The same directions of lines, within -pi/2 <= angle < pi/2."""
    turned: Floats = (angles + np.pi / 2) % np.pi - np.pi / 2
    return turned


def continues(ends_px: Floats, pieces: list[int], i: int) -> bool:
    """Whether line i lies before, behind or between the pieces, by their (N, 2) ends along a direction."""
    (low, *others_low), (high, *others_high) = (
        way(ends_px[[i, *pieces]], axis=1).tolist() for way in (np.min, np.max)
    )
    others = zip(others_low, others_high, strict=True)
    beside_px = sum(max(0.0, min(high, end) - max(low, start)) for start, end in others)
    return bool(beside_px <= _OVERLAP_SHARE * (high - low))
