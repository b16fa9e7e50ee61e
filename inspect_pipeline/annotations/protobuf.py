"""Annotations in protobuf: foxglove.ImageAnnotations, and lsnet.Detections (schemas/lsnet_detections.proto).

Their elements have fixed sizes, so NumPy lays them out all at once: see benchmarks/bench_encode.py.
"""

from __future__ import annotations

from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING

import numpy as np
from foxglove_schemas_protobuf import ImageAnnotations_pb2

from inspect_pipeline.annotations.drawing import draw
from inspect_pipeline.annotations.schema import ANNOTATIONS_SUFFIX, DETECTIONS_SUFFIX, AnnotationSchema
from inspect_pipeline.messages.protobuf import (
    DOUBLE,
    FLOAT,
    Elements,
    double_field,
    field,
    file_descriptor_set,
    float_field,
    timestamp,
    varint_field,
)

if TYPE_CHECKING:
    from inspect_pipeline.annotations.drawing import Drawing
    from inspect_pipeline.recording.types import Frame
    from lsnet.segments import Detections

_POINTS = Elements(3, 2, DOUBLE)  # foxglove.PointsAnnotation.points
_OUTLINE_COLOUR = Elements(4, 4, DOUBLE)  # foxglove.PointsAnnotation.outline_color
_SEGMENTS = Elements(6, 5, FLOAT)  # lsnet.Detections.segments
_LINE_POINTS = Elements(1, 2, FLOAT)  # lsnet.Line.points


@cache
def image_annotations_schema() -> bytes:
    """Return the FileDescriptorSet of foxglove.ImageAnnotations."""
    return file_descriptor_set(ImageAnnotations_pb2.DESCRIPTOR)


@cache
def detections_schema() -> bytes:
    """Return the FileDescriptorSet of lsnet.Detections."""
    return files("inspect_pipeline.schemas").joinpath("lsnet_detections.binpb").read_bytes()


def encode_image_annotations(frame: Frame, detections: Detections | None, min_score: float = 0.0) -> bytes:
    """Encode foxglove.ImageAnnotations, with the image's stamp on the message and on every annotation."""
    stamp = timestamp(frame.stamp_ns)
    drawings = (_points_annotation(stamp, drawing) for drawing in draw(detections, min_score))
    return b"".join(field(2, drawing) for drawing in drawings) + field(5, stamp)


def encode_detections(frame: Frame, detections: Detections | None, _: float = 0.0) -> bytes:
    """Encode lsnet.Detections; of an image that could not be decoded, with the reason."""
    height, width = detections.segments.image_size if detections else (0, 0)
    head = (
        field(1, timestamp(frame.stamp_ns))
        + field(2, frame.frame_id.encode())
        + varint_field(3, frame.frame_idx)
        + varint_field(4, width)
        + varint_field(5, height)
    )
    if detections is None:
        return head + field(8, (frame.error or "").encode())
    segments = detections.segments
    lines = (
        field(7, _LINE_POINTS.encode(points) + float_field(2, score))
        for points, score in zip(detections.lines.points, detections.lines.scores, strict=True)
    )
    return head + _SEGMENTS.encode(np.column_stack((segments.endpoints, segments.scores))) + b"".join(lines)


def _points_annotation(stamp: bytes, drawing: Drawing) -> bytes:
    return (
        field(1, stamp)
        + varint_field(2, drawing.kind)
        + _POINTS.encode(drawing.points)
        + _OUTLINE_COLOUR.encode(drawing.colour[np.newaxis])
        + double_field(7, drawing.thickness_px)
    )


PROTOBUF = (
    AnnotationSchema(
        topic_suffix=ANNOTATIONS_SUFFIX,
        name="foxglove.ImageAnnotations",
        encoding="protobuf",
        data=image_annotations_schema,
        message_encoding="protobuf",
        encode=encode_image_annotations,
    ),
    AnnotationSchema(
        topic_suffix=DETECTIONS_SUFFIX,
        name="lsnet.Detections",
        encoding="protobuf",
        data=detections_schema,
        message_encoding="protobuf",
        encode=encode_detections,
    ),
)
