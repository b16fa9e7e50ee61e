"""Detections as messages: what viewers draw, and the same without loss for programs.

Beside a camera topic stand `<topic>/lsnet/annotations` (ImageAnnotations of Foxglove) and
`<topic>/lsnet/detections` (our own), one message of each per image: in protobuf, or as ROS 2 messages for
those who play bags, whose players take no other encoding beside.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from inspect_pipeline.annotations.protobuf import PROTOBUF
from inspect_pipeline.annotations.ros2 import ROS2

if TYPE_CHECKING:
    from inspect_pipeline.annotations.schema import AnnotationSchema
    from inspect_pipeline.config import SchemaName
    from inspect_pipeline.recording.append import AnnotationWriter
    from inspect_pipeline.recording.types import Frame
    from lsnet.segments import Detections

_SCHEMAS: dict[SchemaName, tuple[AnnotationSchema, ...]] = {"protobuf": PROTOBUF, "ros2msg": ROS2}


class FrameAnnotator:
    """Writes what was found in frames to the annotation channels of their camera topics."""

    def __init__(self, out: AnnotationWriter, schema: SchemaName = "protobuf") -> None:
        self._out = out
        self._schemas = _SCHEMAS[schema]
        self._channel_ids: dict[str, tuple[int, ...]] = {}

    def write(self, frame: Frame, detections: Detections | None) -> None:
        """Write the messages of a frame; None for one whose image could not be decoded.

        Raises RecordingError when the recording has channels of these topics already.
        """
        if frame.topic not in self._channel_ids:
            self._channel_ids[frame.topic] = self._add_channels(frame.topic)
        for channel_id, schema in zip(self._channel_ids[frame.topic], self._schemas, strict=True):
            data = schema.encode(frame, detections)
            self._out.write(channel_id, frame.log_time_ns, frame.publish_time_ns, data)

    def _add_channels(self, topic: str) -> tuple[int, ...]:
        return tuple(
            self._out.add_channel(
                topic + schema.topic_suffix,
                schema_name=schema.name,
                schema_encoding=schema.encoding,
                schema_data=schema.data(),
                message_encoding=schema.message_encoding,
                metadata={"lsnet_pipe.image_topic": topic, **schema.channel_metadata},
            )
            for schema in self._schemas
        )
