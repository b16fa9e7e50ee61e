"""What is drawn onto an image: its lines, coloured by score."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from foxglove_schemas_protobuf.PointsAnnotation_pb2 import PointsAnnotation

from inspect_pipeline.images.draw import score_colours

if TYPE_CHECKING:
    from inspect_pipeline.arrays import Floats, Floats32
    from lsnet.segments import Detections

LINE_STRIP, LINE_LIST = int(PointsAnnotation.LINE_STRIP), int(PointsAnnotation.LINE_LIST)
_MIN_THICKNESS_PX, _WIDTHS_PER_IMAGE = 2.0, 500  # 2 px are invisible on an image of 20 megapixels


class Drawing(NamedTuple):
    """One annotation: its type, points (N, 2) in pixels, RGBA (4,) in [0, 1], and thickness in pixels."""

    kind: int
    points: Floats32
    colour: Floats
    thickness_px: float


def draw(detections: Detections | None, min_score: float) -> list[Drawing]:
    """Return an annotation for each line; an empty one where there is nothing to draw.

    Viewers match annotations to images by their stamps, so they would show those of an earlier image on one
    that has none. Colours are spread over the scores from `min_score` to 1.
    """
    if not detections or not len(detections.lines):
        return [Drawing(LINE_LIST, np.zeros((0, 2), np.float32), np.zeros(4), _MIN_THICKNESS_PX)]
    _, width = detections.segments.image_size
    thickness_px = max(_MIN_THICKNESS_PX, width / _WIDTHS_PER_IMAGE)
    lines = detections.lines
    colours = np.ones((len(lines), 4))
    colours[:, :3] = score_colours(lines.scores, min_score) / 255
    return [
        Drawing(LINE_STRIP, points, colour, thickness_px)
        for points, colour in zip(lines.points, colours, strict=True)
    ]
