"""M-LSD (Gu et al., AAAI 2022), a learned rival: the authors' .tflite file run by OpenVINO.

The file is not shipped: M-LSD_512_tiny_fp32.tflite of github.com/navervision/mlsd, Apache-2.0. As the authors
do, an image is resized to the square of the network, whatever its shape.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import cv2
import numpy as np

from lsnet.errors import LSNetError
from lsnet.evaluation.baselines.lengths import by_length
from lsnet.runtime.choice import openvino_core

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from lsnet.arrays import Floats32, ImageArray, Ints32
    from lsnet.segments import Detections

MIN_CENTRE_SCORE = 0.1  # the authors' value
MIN_LENGTH_PX = 20.0  # the authors' own, in positions of the network's map, which has half the image's size


class MLSD:
    """Reports each segment also as a line, scored by length."""

    min_score: ClassVar[float] = 0.5  # 69 px

    def __init__(self, path: Path, precision: str = "f32") -> None:
        """Load the file. Raises LSNetError when it cannot be read or OpenVINO is not installed."""
        core, options = openvino_core(), {"INFERENCE_PRECISION_HINT": precision}
        try:
            self._model = core.compile_model(str(path), "CPU", options)
        except RuntimeError as err:
            raise LSNetError(f"{path}: not a network OpenVINO can read; give M-LSD's .tflite") from err
        self._side = int(self._model.input(0).shape[1])

    def detect(self, images: Sequence[ImageArray]) -> list[Detections]:
        """Detect in uint8 (H, W, 3) RGB images, in the pixels of each."""
        return [self._detect(image) for image in images]

    def _detect(self, image: ImageArray) -> Detections:
        size = (image.shape[0], image.shape[1])
        square = cv2.resize(image, (self._side, self._side), interpolation=cv2.INTER_AREA)
        opaque = np.ones((self._side, self._side, 1), np.float32)
        found: Any = self._model(np.concatenate([square, opaque], axis=-1, dtype=np.float32)[None])
        centres, scores, displacements = (np.asarray(found[i][0]) for i in range(3))
        return decode(centres, scores, displacements, size)


def decode(
    centres: Ints32,
    centre_scores: Floats32,
    displacements: Floats32,
    size: tuple[int, int],
) -> Detections:
    """Decode the network's output for an image of (height, width).

    Args:
        centres: (K, 2) row and column in the map.
        centre_scores: (K,).
        displacements: (R, C, 4), from each position of the map to both ends, x1 y1 x2 y2 in map positions.
        size: (height, width) of the image.
    """
    rows, columns = displacements.shape[:2]
    steps = displacements[centres[:, 0], centres[:, 1]]
    is_kept = (centre_scores > MIN_CENTRE_SCORE) & (
        np.hypot(*(steps[:, 2:] - steps[:, :2]).T) > MIN_LENGTH_PX
    )
    ends = (steps + np.tile(centres[:, ::-1] + 0.5, 2))[is_kept]
    ends = (ends * np.tile([size[1] / columns, size[0] / rows], 2)).astype(np.float32)
    return by_length(ends, size)
