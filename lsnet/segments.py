"""Results of the detector: `Segments` of grid cells, `Lines` merged from them, `Detections` of one image.

Pixel convention throughout this project: the origin is the top-left corner of the top-left pixel, so the
centre of the pixel in row i and column j is (x, y) = (j + 0.5, i + 0.5). Endpoints are xyxy, sizes are
(height, width).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from lsnet.arrays import Floats32, Ints32, Mask


@dataclass(frozen=True, slots=True, eq=False)
class Segments:
    """Line segments of one image.

    Attributes:
        endpoints: (N, 4) float32, x1 y1 x2 y2 in pixels of an image of `image_size`.
        scores: (N,) float32 in [0, 1].
        image_size: (height, width) in pixels.

    Raises:
        ValueError: The shapes disagree.
    """

    endpoints: Floats32
    scores: Floats32
    image_size: tuple[int, int]

    def __post_init__(self) -> None:
        if self.endpoints.ndim != 2 or self.endpoints.shape[1] != 4:
            raise ValueError(f"endpoints must be (N, 4), not {self.endpoints.shape}")
        if self.scores.shape != self.endpoints.shape[:1]:
            raise ValueError(f"{len(self.endpoints)} endpoints with scores of shape {self.scores.shape}")

    def __len__(self) -> int:
        return len(self.scores)

    @classmethod
    def empty(cls, image_size: tuple[int, int]) -> Segments:
        """Return no segments in an image of (height, width)."""
        return cls(np.zeros((0, 4), np.float32), np.zeros(0, np.float32), image_size)

    def above(self, min_score: float) -> Segments:
        """Return the segments with a score of at least `min_score`, in the same order."""
        keep = self.scores >= min_score
        return Segments(self.endpoints[keep], self.scores[keep], self.image_size)

    def scaled_to(self, image_size: tuple[int, int]) -> Segments:
        """Return the segments in the pixels of the image resized to (height, width)."""
        if image_size == self.image_size:
            return self
        sy, sx = image_size[0] / self.image_size[0], image_size[1] / self.image_size[1]
        factor = np.array([sx, sy, sx, sy], np.float32)
        return Segments(self.endpoints * factor, self.scores, image_size)


@dataclass(frozen=True, slots=True, eq=False)
class Lines:
    """Polylines of one image.

    Attributes:
        points: One (K, 2) float32 array of x, y per line, K >= 2, in order along the line.
        scores: (M,) float32 in [0, 1].
        image_size: (height, width) in pixels.

    Raises:
        ValueError: The shapes disagree.
    """

    points: tuple[Floats32, ...]
    scores: Floats32
    image_size: tuple[int, int]

    def __post_init__(self) -> None:
        if self.scores.shape != (len(self.points),):
            raise ValueError(f"{len(self.points)} lines with scores of shape {self.scores.shape}")
        if any(p.ndim != 2 or p.shape[1] != 2 or len(p) < 2 for p in self.points):
            raise ValueError("each line must be (K, 2) with K >= 2")

    def __len__(self) -> int:
        return len(self.points)

    @classmethod
    def empty(cls, image_size: tuple[int, int]) -> Lines:
        """Return no lines in an image of (height, width)."""
        return cls((), np.zeros(0, np.float32), image_size)

    def above(self, min_score: float) -> Lines:
        """Return the lines with a score of at least `min_score`, in the same order."""
        return self.take(self.scores >= min_score)

    def take(self, is_taken: Mask) -> Lines:
        """Return the lines (M,) that are taken, in the same order."""
        points = tuple(self.points[i] for i in np.flatnonzero(is_taken))
        return Lines(points, self.scores[is_taken], self.image_size)

    def pieces(self) -> Segments:
        """Return the straight pieces of all lines, in order, each with the score of its line."""
        if not len(self):
            return Segments.empty(self.image_size)
        ends = np.concatenate([np.hstack([points[:-1], points[1:]]) for points in self.points])
        scores = np.repeat(self.scores, [len(points) - 1 for points in self.points])
        return Segments(ends.astype(np.float32), scores.astype(np.float32), self.image_size)

    def scaled_to(self, image_size: tuple[int, int]) -> Lines:
        """Return the lines in the pixels of the image resized to (height, width)."""
        if image_size == self.image_size:
            return self
        factor = np.array(
            [image_size[1] / self.image_size[1], image_size[0] / self.image_size[0]], np.float32
        )
        return Lines(tuple(points * factor for points in self.points), self.scores, image_size)


@dataclass(frozen=True, slots=True, eq=False)
class Detections:
    """Segments and lines of one image, in the pixels of that image.

    Attributes:
        segments: One segment per grid cell that reports one.
        lines: Polylines merged from the segments.
        line_of: (N,) int32, the index of the line each segment belongs to, -1 for none; None if unknown.
    """

    segments: Segments
    lines: Lines
    line_of: Ints32 | None = None

    @classmethod
    def empty(cls, image_size: tuple[int, int]) -> Detections:
        """Return no detections in an image of (height, width)."""
        return cls(Segments.empty(image_size), Lines.empty(image_size))

    def above(self, min_score: float, min_line_score: float | None = None) -> Detections:
        """Return the segments and the lines whose own score is at least `min_score`, in the same order.

        The least score of lines is `min_line_score`, if that is given.
        """
        line_of = self.line_of
        if line_of is not None:
            line_of = line_of[self.segments.scores >= min_score]
        found = Detections(self.segments.above(min_score), self.lines, line_of)
        return found.take_lines(
            self.lines.scores >= (min_score if min_line_score is None else min_line_score)
        )

    def take_lines(self, is_taken: Mask) -> Detections:
        """Return all segments, and the lines (M,) that are taken, in the same order."""
        line_of = self.line_of
        if line_of is not None:
            new_index = np.append(np.where(is_taken, np.cumsum(is_taken) - 1, -1), -1)  # -1 stays -1
            line_of = new_index.astype(np.int32)[line_of]
        return Detections(self.segments, self.lines.take(is_taken), line_of)

    def scaled_to(self, image_size: tuple[int, int]) -> Detections:
        """Return the detections in the pixels of the image resized to (height, width)."""
        return Detections(self.segments.scaled_to(image_size), self.lines.scaled_to(image_size), self.line_of)
