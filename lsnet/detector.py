"""`Detector`: images in, detections in the pixels of those images out.

Resizing is done, and undone, here and nowhere else.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from lsnet.chaining import MergeConfig, merge_with_owners
from lsnet.errors import LSNetError
from lsnet.geometry import clip_to_boxes
from lsnet.grid import GridCoder
from lsnet.runtime import open_backend
from lsnet.segments import Detections, Segments
from lsnet.tiles import STRIDE_PX, join, tiles_of
from lsnet.weights import load_weights

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from lsnet.runtime import Backend
    from lsnet.weights import Weights

SMALLEST_PX = 32  # one cell
ENLARGE_TO_PX = 384  # the size of training images; thin wires of much smaller images are lost otherwise
MOST_SCALE = 4


class Detector:
    """A network with its runtime, scale and threshold; a batch equals its singles."""

    def __init__(self, weights: Weights, backend: Backend, scale: float | None, min_score: float) -> None:
        self._weights, self._backend = weights, backend
        self._coder, self._merge_config = GridCoder(), MergeConfig()
        self._least_score = min(min_score, self._merge_config.min_segment_score)
        self.scale, self.min_score = scale, min_score

    @classmethod
    def load(
        cls,
        weights: str | Path = "fast",
        *,
        runtime: str = "auto",
        scale: float | None = None,
        min_score: float | None = None,
    ) -> Detector:
        """A detector by the name or file of its weights.

        scale: frames are resized by it before detection; without one, in the weights neither, frames of
        less than half the size of training images are enlarged by a whole number. min_score: least score
        of a segment that is told, by default the weights' own. Raises LSNetError when the weights or the
        runtime cannot be used or a number is out of range.
        """
        loaded = load_weights(weights)
        scale = loaded.card.scale if scale is None else scale
        min_score = loaded.card.min_score if min_score is None else min_score
        if scale is not None and not 0.05 <= scale <= MOST_SCALE:
            raise LSNetError(f"scale {scale:g} is out of range; give a factor from 0.05 to {MOST_SCALE}")
        if not 0 <= min_score <= 1:
            raise LSNetError(f"minimum score {min_score:g} is out of range; give a number from 0 to 1")
        return cls(loaded, open_backend(loaded.net, runtime), scale, min_score)

    def describe(self) -> dict[str, str | int | float]:
        """What was used, for the record: weights, sha256, preset, backend, precision, scale, threshold."""
        return {
            "weights": self._weights.card.name,
            "weights_sha256": self._weights.sha256,
            "preset": self._weights.card.preset,
            "backend": self._backend.name,
            "precision": self._backend.precision,
            "scale": "auto" if self.scale is None else self.scale,
            "min_score": self.min_score,
        }

    @property
    def threads(self) -> int:
        """Threads that the backend runs on."""
        return self._backend.threads

    def detect(self, images: Sequence[NDArray[np.uint8]]) -> list[Detections]:
        """Detections of each uint8 (H, W, 3) RGB image, in its own pixels.

        Raises ValueError for an array of another shape or type, or an empty one.
        """
        prepared = [self._prepare(image) for image in images]
        cut = [tiles_of(p.shape[0], p.shape[1]) for p in prepared]
        windows = [p[tile.window] for p, tiles in zip(prepared, cut, strict=True) for tile in tiles]
        maps = iter(self._backend.run(windows))
        found = []
        for image, pixels, tiles in zip(images, prepared, cut, strict=True):
            whole = join(pixels.shape[0], pixels.shape[1], tiles, [next(maps) for _ in tiles])
            found.append(self._decode(whole, pixels, image))
        return found

    def scale_of(self, image: NDArray[np.uint8]) -> float:
        """What an image is resized by before detection."""
        if self.scale is not None:
            return self.scale
        return float(min(max(ENLARGE_TO_PX // max(min(image.shape[:2]), 1), 1), MOST_SCALE))

    def _prepare(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Resized by the scale, borders repeated up to multiples of 16."""
        if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8 or not image.size:
            raise ValueError(f"images must be uint8 (H, W, 3), not {image.dtype} {image.shape}")
        height, width = self._scaled_size(image)
        if (height, width) != image.shape[:2]:
            how = cv2.INTER_AREA if height < image.shape[0] else cv2.INTER_LINEAR
            image = np.asarray(cv2.resize(image, (width, height), interpolation=how), np.uint8)
        height, width = image.shape[:2]
        below = max(SMALLEST_PX - height, -height % STRIDE_PX)
        right = max(SMALLEST_PX - width, -width % STRIDE_PX)
        return np.pad(image, ((0, below), (0, right), (0, 0)), mode="edge")

    def _scaled_size(self, image: NDArray[np.uint8]) -> tuple[int, int]:
        height, width = image.shape[:2]
        scale = self.scale_of(image)
        return max(1, round(height * scale)), max(1, round(width * scale))

    def _decode(
        self,
        maps: tuple[NDArray[np.float32], NDArray[np.float32]],
        prepared: NDArray[np.uint8],
        image: NDArray[np.uint8],
    ) -> Detections:
        """Threshold, cells to pixels, padding cut off, chained into lines, resize undone.

        Lines are made of the same segments whatever the threshold, which then applies to their own score.
        """
        source_size = (image.shape[0], image.shape[1])
        scaled_size = self._scaled_size(image)
        raw = self._coder.decode(*maps, (prepared.shape[0], prepared.shape[1]), self._least_score)
        clipped = _clipped(raw, scaled_size)
        enlarged = max(self.scale_of(image), 1.0)
        all_lines, owners = merge_with_owners(clipped, self._merge_config, enlarged)
        lines, segments = all_lines.above(self.min_score), clipped.above(self.min_score)
        owners[owners >= len(lines)] = -1  # lines come strongest first, so the weak ones are the last
        line_of = owners[clipped.scores >= self.min_score]
        return Detections(segments.scaled_to(source_size), lines.scaled_to(source_size), line_of)


def _clipped(segments: Segments, image_size: tuple[int, int]) -> Segments:
    """What of the segments lies in an image of (height, width), which is the top-left part of theirs."""
    ends = segments.endpoints.astype(float)
    t_in, t_out = clip_to_boxes(ends, [0, 0, image_size[1], image_size[0]])
    keep = t_out > t_in
    start, step = ends[keep, :2], ends[keep, 2:] - ends[keep, :2]
    clipped = np.concatenate([start + t_in[keep, None] * step, start + t_out[keep, None] * step], axis=1)
    return Segments(clipped.astype(np.float32), segments.scores[keep], image_size)
