"""`Detector`: images in, detections in the pixels of those images out.

At each level of an image: `prepare` resizes and pads, a backend runs the network, and a `Postprocessor` turns
its raw output into segments and lines and undoes the resizing. The lines of all levels become one set.
"""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from lsnet.errors import LSNetError
from lsnet.images import open_rgb
from lsnet.lines.score import read_line_score
from lsnet.postprocess import Postprocessor
from lsnet.preprocess import MAX_SCALE, prepare
from lsnet.runtime.backend import open_backend
from lsnet.scales import levels_of, merge_levels
from lsnet.tiles import join, tiles_of
from lsnet.weights_file import WeightsFile, read_weights

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from contextlib import AbstractContextManager

    from lsnet.arrays import ImageArray, Maps
    from lsnet.images import ColorOrder, ImageInput
    from lsnet.preprocess import PreparedImage
    from lsnet.runtime.backend import Backend
    from lsnet.segments import Detections
    from lsnet.weights import Weights


class Detector:
    """A network with its runtime, scale and threshold; a batch gives the same results as its images alone.

    Attributes:
        scale: Factor by which images are resized before detection; None for the levels of `scales`.
        min_score: Lowest score of a segment or line that is reported.
    """

    def __init__(
        self, weights: Weights | WeightsFile, backend: Backend, scale: float | None, min_score: float
    ) -> None:
        self._card, self._sha256, self._backend = weights.card, weights.sha256, backend
        line_score = read_line_score(weights) if isinstance(weights, WeightsFile) else None
        self._postprocess = Postprocessor(min_score, line_score)
        self.scale, self.min_score = scale, min_score

    @classmethod
    def load(
        cls,
        weights: str | Path = "fast",
        *,
        runtime: str = "auto",
        device: str | None = None,
        threads: int | None = None,
        scale: float | None = None,
        min_score: float | None = None,
    ) -> Detector:
        """Load a detector.

        Args:
            weights: Name of shipped weights (see `list_weights`), or a .safetensors file.
            runtime: auto, torch, torch-bf16, torch-f16, openvino, openvino-bf16 or openvino-int8.
            device: Of torch: cpu, cuda or cuda:N. Default: the first GPU, if there is one.
            threads: Of the CPU. Default: one per core.
            scale: Factor by which images are resized before detection. Default: that of the weights; if
                they have none, several as the size of the image asks, see `levels_of`.
            min_score: Lowest score of a segment or line to report. Default: that of the weights.

        Raises:
            LSNetError: The weights or the runtime cannot be used, or a number is out of range.
        """
        file = read_weights(weights)
        scale = file.card.scale if scale is None else scale
        min_score = file.card.min_score if min_score is None else min_score
        if scale is not None and not 0.05 <= scale <= MAX_SCALE:
            raise LSNetError(f"scale {scale:g} is out of range; give a factor from 0.05 to {MAX_SCALE:g}")
        if not 0 <= min_score <= 1:
            raise LSNetError(f"minimum score {min_score:g} is out of range; give a number from 0 to 1")
        return cls(file, open_backend(file, runtime, device, threads), scale, min_score)

    def describe(self) -> dict[str, str | int | float]:
        """Return what determines the results: weights, backend, precision, scale and threshold."""
        return {
            "weights": self._card.name,
            "weights_sha256": self._sha256,
            "preset": self._card.preset,
            "backend": self._backend.name,
            "precision": self._backend.precision,
            "scale": "auto" if self.scale is None else self.scale,
            "min_score": self.min_score,
        }

    @property
    def threads(self) -> int:
        """Number of threads of the CPU that the backend uses."""
        return self._backend.threads

    @property
    def n_calls(self) -> int:
        """Calls of `detect` at a time, from several threads, that keep the backend busy."""
        return self._backend.n_calls

    @property
    def n_images(self) -> int:
        """Images of one size in a call that the backend runs together."""
        return self._backend.n_images

    def detect(
        self,
        images: ImageInput | Sequence[ImageInput],
        *,
        color: ColorOrder = "rgb",
        timed: Callable[[str], AbstractContextManager[object]] = nullcontext,
        min_line_score: float | None = None,
    ) -> list[Detections]:
        """Detect segments and lines; one result per image, in the pixels of that image.

        Args:
            images: Paths of image files, or uint8 arrays (height, width, 3). A single one is a batch of one.
            color: Order of the channels of arrays: rgb, or bgr as `cv2.imread` returns. The order cannot
                be recognised, and the wrong one costs accuracy.
            timed: Called with the name of each stage, prepare, infer and merge, for a context to run it in.
            min_line_score: Lowest score of a line, where candidates are wanted as well. Default: `min_score`.

        Raises:
            LSNetError: A file cannot be read, or an array has another shape or type.
        """
        if isinstance(images, str | Path) or (isinstance(images, np.ndarray) and images.ndim <= 3):
            images = [images]
        opened = [open_rgb(image, color) for image in images]
        with timed("prepare"):
            levels = [self.levels_of(image) for image in opened]
            prepared = [
                prepare(image, level) for image, own in zip(opened, levels, strict=True) for level in own
            ]
        found, results = self._find(prepared, min_line_score, timed), []
        for own in levels:
            at_levels = [next(found) for _ in own]
            with timed("merge"):
                results.append(merge_levels(at_levels, own))
        return results

    def levels_of(self, image: ImageArray) -> tuple[float, ...]:
        """Return the factors by which an image is resized before detection."""
        return levels_of((image.shape[0], image.shape[1])) if self.scale is None else (self.scale,)

    def _find(
        self,
        prepared: Sequence[PreparedImage],
        min_line_score: float | None,
        timed: Callable[[str], AbstractContextManager[object]],
    ) -> Iterator[Detections]:
        """Yield what is found in each image, while the next ones run."""
        maps = self._run(prepared)
        for image in prepared:
            with timed("infer"):
                raw = next(maps)
            with timed("merge"):
                found = self._postprocess(raw, image, min_line_score)
            yield found

    def _run(self, prepared: Sequence[PreparedImage]) -> Iterator[Maps]:
        """Yield the raw maps of each image; very large images are run in tiles."""
        max_pixels = self._card.network.pixels_at_once
        tiles = [tiles_of(*image.padded_size, max_pixels) for image in prepared]
        windows = [
            image.pixels[tile.window] for image, cut in zip(prepared, tiles, strict=True) for tile in cut
        ]
        maps = iter(self._backend.run(windows))
        for image, cut in zip(prepared, tiles, strict=True):
            yield join(*image.padded_size, cut, [next(maps) for _ in cut])
