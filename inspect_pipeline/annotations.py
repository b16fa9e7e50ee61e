"""Detections as messages: what viewers draw, and the same without loss for programs.

Beside a camera topic stand `<topic>/lsnet/annotations` (foxglove.ImageAnnotations) and
`<topic>/lsnet/detections` (lsnet.Detections, schemas/lsnet_detections.proto), both protobuf, one message of
each per image. Their elements have fixed sizes, so NumPy lays them out all at once.
"""

from __future__ import annotations

from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING

import numpy as np
from foxglove_schemas_protobuf import ImageAnnotations_pb2
from foxglove_schemas_protobuf.PointsAnnotation_pb2 import PointsAnnotation

from inspect_pipeline.protobuf import (
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
    from numpy.typing import NDArray

    from inspect_pipeline.types import Frame
    from inspect_pipeline.writeback import AnnotationWriter
    from lsnet.segments import Detections, Lines, Segments

ANNOTATIONS_SUFFIX = "/lsnet/annotations"
DETECTIONS_SUFFIX = "/lsnet/detections"
_THICKNESS_PX = 2.0
_FAINT_RGBA = np.array([1.0, 0.55, 0.0, 1.0])  # at score 0; blends into
_SURE_RGBA = np.array([0.0, 1.0, 1.0, 1.0])  # at score 1

_POINTS = Elements(3, 2, DOUBLE)  # foxglove.PointsAnnotation.points
_OUTLINE_COLOUR = Elements(4, 4, DOUBLE)  # foxglove.PointsAnnotation.outline_color
_OUTLINE_COLOURS = Elements(5, 4, DOUBLE)  # foxglove.PointsAnnotation.outline_colors
_SEGMENTS = Elements(6, 5, FLOAT)  # lsnet.Detections.segments
_LINE_POINTS = Elements(1, 2, FLOAT)  # lsnet.Line.points


class FrameAnnotator:
    """Writes what was found in frames to the annotation channels of their camera topics."""

    def __init__(self, out: AnnotationWriter) -> None:
        self._out = out
        self._channel_ids: dict[str, tuple[int, int]] = {}

    def write(self, frame: Frame, detections: Detections | None) -> None:
        """Write both messages of a frame; None for one whose image could not be decoded.

        Raises RecordingError when the recording has channels of these topics already.
        """
        if frame.topic not in self._channel_ids:
            self._channel_ids[frame.topic] = self._add_channels(frame.topic)
        annotations_id, detections_id = self._channel_ids[frame.topic]
        times = (frame.log_time_ns, frame.publish_time_ns)
        self._out.write(annotations_id, *times, encode_image_annotations(frame, detections))
        self._out.write(detections_id, *times, encode_detections(frame, detections))

    def _add_channels(self, topic: str) -> tuple[int, int]:
        annotations_id, detections_id = (
            self._out.add_channel(
                topic + suffix,
                schema_name=schema_name,
                schema_encoding="protobuf",
                schema_data=schema_data,
                message_encoding="protobuf",
                metadata={"lsnet_pipe.image_topic": topic},
            )
            for suffix, schema_name, schema_data in (
                (ANNOTATIONS_SUFFIX, "foxglove.ImageAnnotations", image_annotations_schema()),
                (DETECTIONS_SUFFIX, "lsnet.Detections", detections_schema()),
            )
        )
        return annotations_id, detections_id


@cache
def image_annotations_schema() -> bytes:
    """foxglove.ImageAnnotations as a serialised FileDescriptorSet."""
    return file_descriptor_set(ImageAnnotations_pb2.DESCRIPTOR)


@cache
def detections_schema() -> bytes:
    """lsnet.Detections as a serialised FileDescriptorSet."""
    return files("inspect_pipeline.schemas").joinpath("lsnet_detections.binpb").read_bytes()


def encode_image_annotations(frame: Frame, detections: Detections | None) -> bytes:
    """A foxglove.ImageAnnotations message: the lines when there are any, else the segments.

    Every annotation carries the image's stamp, by which viewers match it to the image; one without points
    stands for an image with nothing to draw.
    """
    stamp = timestamp(frame.stamp_ns)
    if detections and len(detections.lines):
        annotations = _line_strips(stamp, detections.lines)
    elif detections and len(detections.segments):
        annotations = [_line_list(stamp, detections.segments)]
    else:
        annotations = [
            _points_annotation(stamp, PointsAnnotation.LINE_LIST, np.zeros((0, 2), np.float32), b"")
        ]
    return b"".join(field(2, annotation) for annotation in annotations) + field(5, stamp)


def encode_detections(frame: Frame, detections: Detections | None) -> bytes:
    """An lsnet.Detections message; of an image that could not be decoded, with the reason."""
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


def _line_list(stamp: bytes, segments: Segments) -> bytes:
    """All segments as one annotation, coloured by score."""
    colours = _OUTLINE_COLOURS.encode(_colours(segments.scores))
    return _points_annotation(stamp, PointsAnnotation.LINE_LIST, segments.endpoints.reshape(-1, 2), colours)


def _line_strips(stamp: bytes, lines: Lines) -> list[bytes]:
    """One annotation per line, coloured by score."""
    colours = _colours(lines.scores)
    return [
        _points_annotation(
            stamp, PointsAnnotation.LINE_STRIP, points, _OUTLINE_COLOUR.encode(colours[i : i + 1])
        )
        for i, points in enumerate(lines.points)
    ]


def _points_annotation(stamp: bytes, kind: int, points: NDArray[np.float32], colours: bytes) -> bytes:
    """A foxglove.PointsAnnotation of (N, 2) points in pixels."""
    thickness = double_field(7, _THICKNESS_PX)
    return field(1, stamp) + varint_field(2, kind) + _POINTS.encode(points) + colours + thickness


def _colours(scores: NDArray[np.float32]) -> NDArray[np.float64]:
    """(N, 4) RGBA of (N,) scores."""
    colours: NDArray[np.float64] = _FAINT_RGBA + scores[:, np.newaxis] * (_SURE_RGBA - _FAINT_RGBA)
    return colours
