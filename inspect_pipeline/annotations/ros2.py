"""Annotations as ROS 2 messages in CDR: foxglove_msgs/msg/ImageAnnotations and lsnet_msgs/msg/Detections.

Their definitions are in schemas/*.msg.
"""

from __future__ import annotations

from importlib.resources import files
from typing import TYPE_CHECKING

import numpy as np

from inspect_pipeline.annotations.drawing import draw
from inspect_pipeline.annotations.schema import ANNOTATIONS_SUFFIX, DETECTIONS_SUFFIX, AnnotationSchema
from inspect_pipeline.messages.cdr import CdrWriter

if TYPE_CHECKING:
    from inspect_pipeline.annotations.drawing import Drawing
    from inspect_pipeline.recording.types import Frame
    from lsnet.segments import Detections


def encode_image_annotations(frame: Frame, detections: Detections | None, min_score: float = 0.0) -> bytes:
    """Encode foxglove_msgs/msg/ImageAnnotations, every annotation with the image's stamp."""
    out = CdrWriter()
    drawings = draw(detections, min_score)
    out.number("I", 0)  # circles
    out.number("I", len(drawings))
    for drawing in drawings:
        _write_points_annotation(out, frame.stamp_ns, drawing)
    out.number("I", 0)  # texts
    return out.finish()


def _write_points_annotation(out: CdrWriter, stamp_ns: int, drawing: Drawing) -> None:
    out.time(stamp_ns)
    out.number("B", drawing.kind)
    out.sequence(drawing.points, "<f8")
    out.numbers(drawing.colour, "<f8")
    out.sequence(np.zeros((0, 4)), "<f8")  # colours of single points
    out.numbers(np.zeros(4), "<f8")  # fill
    out.number("d", drawing.thickness_px)


def encode_detections(frame: Frame, detections: Detections | None, _: float = 0.0) -> bytes:
    """Encode lsnet_msgs/msg/Detections; of an image that could not be decoded, with the reason."""
    height, width = detections.segments.image_size if detections else (0, 0)
    out = CdrWriter()
    out.time(frame.stamp_ns)
    out.text(frame.frame_id)
    out.number("Q", frame.frame_idx)
    out.number("I", width)
    out.number("I", height)
    if detections is None:
        out.number("I", 0)
        out.number("I", 0)
        out.text(frame.error or "")
        return out.finish()
    segments, lines = detections.segments, detections.lines
    out.sequence(np.column_stack((segments.endpoints, segments.scores)), "<f4")
    out.number("I", len(lines))
    for points, score in zip(lines.points, lines.scores, strict=True):
        out.sequence(points, "<f4")
        out.number("f", score)
    out.text("")
    return out.finish()


def _definition(name: str) -> bytes:
    return files("inspect_pipeline.schemas").joinpath(name).read_bytes()


# Readers of rosbag2 require the key of the quality of service, which may be empty.
_QOS = {"offered_qos_profiles": ""}
ROS2 = (
    AnnotationSchema(
        topic_suffix=ANNOTATIONS_SUFFIX,
        name="foxglove_msgs/msg/ImageAnnotations",
        encoding="ros2msg",
        data=lambda: _definition("foxglove_ImageAnnotations.msg"),
        message_encoding="cdr",
        encode=encode_image_annotations,
        channel_metadata=_QOS,
    ),
    AnnotationSchema(
        topic_suffix=DETECTIONS_SUFFIX,
        name="lsnet_msgs/msg/Detections",
        encoding="ros2msg",
        data=lambda: _definition("lsnet_Detections.msg"),
        message_encoding="cdr",
        encode=encode_detections,
        channel_metadata=_QOS,
    ),
)
