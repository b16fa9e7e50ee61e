"""Encoding a foxglove.ImageAnnotations of 200 segments, against protobuf in Python."""

from __future__ import annotations

import math
import sys
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.Point2_pb2 import Point2
from foxglove_schemas_protobuf.PointsAnnotation_pb2 import PointsAnnotation
from measure import alternate, conclude, measured, median_ratio, print_run, print_table

from inspect_pipeline.annotations.protobuf import encode_image_annotations
from inspect_pipeline.recording.types import Frame
from lsnet.segments import Detections, Lines, Segments

if TYPE_CHECKING:
    from collections.abc import Callable

N_SEGMENTS = 200
N_REPEATS = 400
N_ROUNDS = 7
BARS = {"times_protobuf": (3.5, math.inf)}
FRAME = Frame(1, "/camera", 0, 10**18, 10**18, 10**18, "cam", None)


def detections() -> Detections:
    random = np.random.default_rng(0)
    endpoints = random.uniform(0, 1000, (N_SEGMENTS, 4)).astype(np.float32)
    segments = Segments(endpoints, random.random(N_SEGMENTS, np.float32), (1080, 1920))
    return Detections(segments, Lines.empty((1080, 1920)))


def with_protobuf(frame: Frame, found: Detections) -> bytes:
    message = ImageAnnotations()
    message.timestamp.FromNanoseconds(frame.stamp_ns)
    annotation = PointsAnnotation(type=PointsAnnotation.LINE_LIST, thickness=2.0)
    annotation.timestamp.FromNanoseconds(frame.stamp_ns)
    for x1, y1, x2, y2 in found.segments.endpoints.tolist():
        annotation.points.extend((Point2(x=x1, y=y1), Point2(x=x2, y=y2)))
    for score in found.segments.scores.tolist():
        annotation.outline_colors.append(Color(r=1 - score, g=0.55 + 0.45 * score, b=score, a=1.0))
    message.points.append(annotation)
    return message.SerializeToString()


METHODS: dict[str, Callable[[Frame, Detections], bytes]] = {
    "annotations": encode_image_annotations,
    "protobuf": with_protobuf,
}


def repeat(encode: Callable[[Frame, Detections], bytes], found: Detections) -> None:
    for _ in range(N_REPEATS):
        encode(FRAME, found)


def main() -> int:
    runs = alternate(__file__, METHODS, N_ROUNDS)
    print(f"{N_REPEATS} messages of {N_SEGMENTS} segments each:")
    print_table(runs)
    ratio = median_ratio(runs, "protobuf", "annotations")
    least_ms = min(run.seconds for run in runs["annotations"]) / N_REPEATS * 1e3
    return conclude("encode", {"times_protobuf": ratio, "ms_per_message": least_ms}, BARS)


if __name__ == "__main__":
    if len(sys.argv) > 1:
        print_run(measured(partial(repeat, METHODS[sys.argv[1]], detections())))
    else:
        sys.exit(main())
