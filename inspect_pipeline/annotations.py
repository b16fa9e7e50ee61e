"""Detections as messages: what viewers draw, and the same without loss for programs.

Beside a camera topic stand `<topic>/lsnet/annotations` (foxglove.ImageAnnotations) and
`<topic>/lsnet/detections` (lsnet.Detections, schemas/lsnet_detections.proto), both protobuf, one message of
each per image. Their elements have fixed sizes, so NumPy lays them out all at once.
"""

from __future__ import annotations

import struct
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING

import numpy as np
from foxglove_schemas_protobuf import ImageAnnotations_pb2
from foxglove_schemas_protobuf.PointsAnnotation_pb2 import PointsAnnotation
from google.protobuf.descriptor_pb2 import FileDescriptorSet

if TYPE_CHECKING:
    from google.protobuf.descriptor import FileDescriptor
    from numpy.typing import NDArray

    from inspect_pipeline.types import Frame
    from inspect_pipeline.writeback import AnnotationWriter
    from lsnet.segments import Detections, Lines, Segments

ANNOTATIONS_SUFFIX = "/lsnet/annotations"
DETECTIONS_SUFFIX = "/lsnet/detections"
_THICKNESS_PX = 2.0
_FAINT_RGBA = np.array([1.0, 0.55, 0.0, 1.0])  # at score 0; blends into
_SURE_RGBA = np.array([0.0, 1.0, 1.0, 1.0])  # at score 1

# Wire types of protobuf. A field's tag is its number and its wire type.
_VARINT, _DOUBLE, _BYTES, _FLOAT = 0, 1, 2, 5


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
    """foxglove.ImageAnnotations as a serialised FileDescriptorSet, imports before their users."""
    found: dict[str, FileDescriptor] = {}

    def visit(file: FileDescriptor) -> None:
        for dependency in file.dependencies:
            visit(dependency)
        found.setdefault(file.name, file)

    visit(ImageAnnotations_pb2.DESCRIPTOR)
    descriptor_set = FileDescriptorSet()
    for file in found.values():
        file.CopyToProto(descriptor_set.file.add())
    return descriptor_set.SerializeToString()


@cache
def detections_schema() -> bytes:
    """lsnet.Detections as a serialised FileDescriptorSet."""
    return files("inspect_pipeline.schemas").joinpath("lsnet_detections.binpb").read_bytes()


def encode_image_annotations(frame: Frame, detections: Detections | None) -> bytes:
    """A foxglove.ImageAnnotations message: the lines when there are any, else the segments.

    Every annotation carries the image's stamp, by which viewers match it to the image; one without points
    stands for an image with nothing to draw.
    """
    stamp = _timestamp(frame.stamp_ns)
    if detections and len(detections.lines):
        annotations = _line_strips(stamp, detections.lines)
    elif detections and len(detections.segments):
        annotations = [_line_list(stamp, detections.segments)]
    else:
        annotations = [
            _points_annotation(stamp, PointsAnnotation.LINE_LIST, np.zeros((0, 2), np.float32), b"")
        ]
    return b"".join(_field(2, annotation) for annotation in annotations) + _field(5, stamp)


def encode_detections(frame: Frame, detections: Detections | None) -> bytes:
    """An lsnet.Detections message; of an image that could not be decoded, with the reason."""
    height, width = detections.segments.image_size if detections else (0, 0)
    head = (
        _field(1, _timestamp(frame.stamp_ns))
        + _field(2, frame.frame_id.encode())
        + _varint_field(3, frame.frame_idx)
        + _varint_field(4, width)
        + _varint_field(5, height)
    )
    if detections is None:
        return head + _field(8, (frame.error or "").encode())
    segments = detections.segments
    lines = (
        _field(7, _LINE_POINTS.encode(points) + _tag(2, _FLOAT) + struct.pack("<f", score))
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
    thickness = _tag(7, _DOUBLE) + struct.pack("<d", _THICKNESS_PX)
    return _field(1, stamp) + _varint_field(2, kind) + _POINTS.encode(points) + colours + thickness


def _colours(scores: NDArray[np.float32]) -> NDArray[np.float64]:
    """(N, 4) RGBA of (N,) scores."""
    colours: NDArray[np.float64] = _FAINT_RGBA + scores[:, np.newaxis] * (_SURE_RGBA - _FAINT_RGBA)
    return colours


class _Elements:
    """A repeated field `number` of messages whose fields 1, 2, ... are all floats, or all doubles."""

    def __init__(self, number: int, n_fields: int, wire_type: int) -> None:
        self._columns = [f"f{i}" for i in range(1, n_fields + 1)]
        value = "<f8" if wire_type == _DOUBLE else "<f4"
        head: list[tuple[str, str]] = [("tag", "u1"), ("size", "u1")]
        body = [column for name in self._columns for column in ((f"{name}_tag", "u1"), (name, value))]
        self._dtype = np.dtype(head + body)
        self._template = np.zeros((), self._dtype)
        self._template["tag"] = number << 3 | _BYTES
        self._template["size"] = self._dtype.itemsize - 2
        for i, name in enumerate(self._columns, 1):
            self._template[f"{name}_tag"] = i << 3 | wire_type

    def encode(self, values: NDArray[np.floating]) -> bytes:
        """The elements with the (N, n_fields) `values`."""
        rows = np.full(len(values), self._template)
        for column, name in enumerate(self._columns):
            rows[name] = values[:, column]
        return rows.tobytes()


_POINTS = _Elements(3, 2, _DOUBLE)  # foxglove.PointsAnnotation.points
_OUTLINE_COLOUR = _Elements(4, 4, _DOUBLE)  # foxglove.PointsAnnotation.outline_color
_OUTLINE_COLOURS = _Elements(5, 4, _DOUBLE)  # foxglove.PointsAnnotation.outline_colors
_SEGMENTS = _Elements(6, 5, _FLOAT)  # lsnet.Detections.segments
_LINE_POINTS = _Elements(1, 2, _FLOAT)  # lsnet.Line.points


def _tag(number: int, wire_type: int) -> bytes:
    return bytes([number << 3 | wire_type])


def _varint(value: int) -> bytes:
    encoded = bytearray()
    while value > 0x7F:
        encoded.append(value & 0x7F | 0x80)
        value >>= 7
    encoded.append(value)
    return bytes(encoded)


def _varint_field(number: int, value: int) -> bytes:
    return _tag(number, _VARINT) + _varint(value)


def _field(number: int, payload: bytes) -> bytes:
    """A field of a message, a string or bytes."""
    return _tag(number, _BYTES) + _varint(len(payload)) + payload


def _timestamp(time_ns: int) -> bytes:
    """A google.protobuf.Timestamp."""
    seconds, nanos = divmod(time_ns, 1_000_000_000)
    return _varint_field(1, seconds) + _varint_field(2, nanos)
