"""From raw network output to segments and lines in the pixels of the source image."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from lsnet.geometry import clip_to_boxes
from lsnet.grid import GridCoder
from lsnet.lines.chaining import ChainingConfig, chain_segments
from lsnet.segments import Detections, Segments

if TYPE_CHECKING:
    from lsnet.arrays import Maps
    from lsnet.lines.score import LineScore
    from lsnet.preprocess import PreparedImage


@dataclass(frozen=True, slots=True)
class Postprocessor:
    """Decode, clip, chain, threshold, scale.

    Lines are made of the same segments whatever `min_score` is; it then applies to segments and lines, each
    by its own score.
    """

    min_score: float
    line_score: LineScore | None = None  # None: lines are scored by the odds of their segments
    coder: GridCoder = field(default_factory=GridCoder)
    chaining: ChainingConfig = field(default_factory=ChainingConfig)

    def __call__(self, maps: Maps, image: PreparedImage, min_line_score: float | None = None) -> Detections:
        """Return the detections of one image, in pixels of its source.

        Lines may have a score down to `min_line_score`, by default `min_score`.
        """
        min_line_score = self.min_score if min_line_score is None else min_line_score
        min_decoded = min(self.min_score, self.chaining.min_segment_score)
        decoded = self.coder.decode(*maps, image.padded_size, min_decoded)
        segments = clip_segments(decoded, image.scaled_size)
        rate = None
        if self.line_score:
            height, width = image.scaled_size
            rate = partial(
                self.line_score.rate, image.pixels[:height, :width], maps[0], min_score=min_line_score
            )
        chained = chain_segments(
            segments, self.chaining, max(image.scale, 1.0), rate=rate, min_score=min_line_score
        )
        return chained.above(self.min_score, min_line_score).scaled_to(image.source_size)


def clip_segments(segments: Segments, image_size: tuple[int, int]) -> Segments:
    """Clip segments to the top-left (height, width) part of their image."""
    ends = segments.endpoints.astype(float)
    t_in, t_out = clip_to_boxes(ends, [0, 0, image_size[1], image_size[0]])
    keep = t_out > t_in
    start, step = ends[keep, :2], ends[keep, 2:] - ends[keep, :2]
    clipped = np.concatenate([start + t_in[keep, None] * step, start + t_out[keep, None] * step], axis=1)
    return Segments(clipped.astype(np.float32), segments.scores[keep], image_size)
