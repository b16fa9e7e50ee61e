"""Encoding an lsnet.Detections of 200 segments, against protobuf in Python."""

from __future__ import annotations

import math
import sys
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.message_factory import GetMessages
from measure import alternate, conclude, measured, median_ratio, print_run, print_table

from inspect_pipeline.annotations.protobuf import detections_schema, encode_detections
from inspect_pipeline.recording.types import Frame
from lsnet.segments import Detections, Lines, Segments

if TYPE_CHECKING:
    from collections.abc import Callable

N_SEGMENTS = 200
N_REPEATS = 400
N_ROUNDS = 7
BARS = {"times_protobuf": (3.5, math.inf)}
MESSAGE = GetMessages(FileDescriptorSet.FromString(detections_schema()).file)["lsnet.Detections"]
FRAME = Frame(1, "/camera", 0, 10**18, 10**18, 10**18, "cam", None)


def detections() -> Detections:
    random = np.random.default_rng(0)
    endpoints = random.uniform(0, 1000, (N_SEGMENTS, 4)).astype(np.float32)
    segments = Segments(endpoints, random.random(N_SEGMENTS, np.float32), (1080, 1920))
    return Detections(segments, Lines.empty((1080, 1920)))


def with_protobuf(frame: Frame, found: Detections) -> bytes:
    height, width = found.segments.image_size
    message = MESSAGE(frame_id=frame.frame_id, frame_idx=frame.frame_idx, width=width, height=height)
    message.timestamp.FromNanoseconds(frame.stamp_ns)
    for (x1, y1, x2, y2), score in zip(
        found.segments.endpoints.tolist(), found.segments.scores.tolist(), strict=True
    ):
        message.segments.add(x1=x1, y1=y1, x2=x2, y2=y2, score=score)
    return bytes(message.SerializeToString())


METHODS: dict[str, Callable[[Frame, Detections], bytes]] = {
    "annotations": encode_detections,
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
