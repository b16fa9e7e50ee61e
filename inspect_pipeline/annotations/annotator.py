"""Annotation channels beside each camera topic, with one message each per image.

`<topic>/lsnet/annotations` is drawn by viewers, `<topic>/lsnet/detections` is for programs, without loss.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from inspect_pipeline.annotations.protobuf import PROTOBUF
from inspect_pipeline.annotations.ros2 import ROS2

if TYPE_CHECKING:
    from inspect_pipeline.annotations.schema import AnnotationSchema
    from inspect_pipeline.config import SchemaName
    from inspect_pipeline.recording.append import AnnotationWriter
    from inspect_pipeline.recording.types import Frame
    from lsnet.segments import Detections

MessageFormat = Literal["protobuf", "ros2msg"]
ROS2_PROFILE = "ros2"
_SCHEMAS: dict[MessageFormat, tuple[AnnotationSchema, ...]] = {"protobuf": PROTOBUF, "ros2msg": ROS2}


def message_format(schema: SchemaName, profile: str) -> MessageFormat:
    """Return the format of annotations in a recording of this profile.

    With "auto" they are ROS 2 messages in a ROS 2 bag, which players and rosbags only open when all its
    messages are CDR, and protobuf elsewhere.
    """
    if schema == "auto":
        return "ros2msg" if profile == ROS2_PROFILE else "protobuf"
    return schema


class FrameAnnotator:
    """Writes the detections of frames to the annotation channels of their camera topics.

    Args:
        out: the file to annotate.
        schema: the format of the messages.
        min_score: the least score of a line, at which the scale of colours begins.
    """

    def __init__(
        self, out: AnnotationWriter, schema: MessageFormat = "protobuf", min_score: float = 0.0
    ) -> None:
        self._out, self._schemas, self._min_score = out, _SCHEMAS[schema], min_score
        self._channel_ids: dict[str, tuple[int, ...]] = {}

    def write(self, frame: Frame, detections: Detections | None) -> None:
        """Write the messages of a frame; None is for one whose image could not be decoded.

        Raises RecordingError when the recording has channels of these topics already.
        """
        if frame.topic not in self._channel_ids:
            self._channel_ids[frame.topic] = self._add_channels(frame.topic)
        for channel_id, schema in zip(self._channel_ids[frame.topic], self._schemas, strict=True):
            data = schema.encode(frame, detections, self._min_score)
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
