"""What is drawn onto an image: lines when there are any, else segments, coloured by score."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from foxglove_schemas_protobuf.PointsAnnotation_pb2 import PointsAnnotation

if TYPE_CHECKING:
    from inspect_pipeline.arrays import Floats, Floats32
    from lsnet.segments import Detections

THICKNESS_PX = 2.0
LINE_STRIP, LINE_LIST = int(PointsAnnotation.LINE_STRIP), int(PointsAnnotation.LINE_LIST)
_FAINT_RGBA = np.array([1.0, 0.55, 0.0, 1.0])  # at score 0; blends into
_SURE_RGBA = np.array([0.0, 1.0, 1.0, 1.0])  # at score 1


class Drawing(NamedTuple):
    """One annotation: (N, 2) points in pixels, and (M, 4) RGBA.

    Of a LINE_LIST there is a colour per pair of points, of a LINE_STRIP one for the whole.
    """

    kind: int
    points: Floats32
    colours: Floats


def draw(detections: Detections | None) -> list[Drawing]:
    """The annotations of an image; one without points where there is nothing to draw.

    Viewers match annotations to images by their stamps, so an image without any keeps the last ones.
    """
    if detections and len(detections.lines):
        colours = _colours(detections.lines.scores)
        return [
            Drawing(LINE_STRIP, points, colours[i : i + 1])
            for i, points in enumerate(detections.lines.points)
        ]
    if detections and len(detections.segments):
        segments = detections.segments
        return [Drawing(LINE_LIST, segments.endpoints.reshape(-1, 2), _colours(segments.scores))]
    return [Drawing(LINE_LIST, np.zeros((0, 2), np.float32), np.zeros((0, 4)))]


def _colours(scores: Floats32) -> Floats:
    """(N, 4) RGBA of (N,) scores."""
    colours: Floats = _FAINT_RGBA + scores[:, np.newaxis] * (_SURE_RGBA - _FAINT_RGBA)
    return colours
