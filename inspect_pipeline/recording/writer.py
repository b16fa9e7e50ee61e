"""Write new recordings of camera images and poses: Foxglove schemas in protobuf, zstd chunks."""

from __future__ import annotations

import errno
import os
from contextlib import contextmanager
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal, NamedTuple, cast

from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.GeoJSON_pb2 import GeoJSON
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from foxglove_schemas_protobuf.Log_pb2 import Log
from mcap.writer import CompressionType, Writer

from inspect_pipeline.atomic import appearing
from inspect_pipeline.messages.protobuf import file_descriptor_set
from inspect_pipeline.recording.types import NOMINAL, PHOTOGRAPHS, SOURCE_KEY
from inspect_pipeline.resources import app_version

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from google.protobuf.descriptor import FileDescriptor
    from google.protobuf.message import Message
    from mcap.records import Attachment, Channel, Schema

    from inspect_pipeline.geometry.attitude import Quaternion


LogLevel = Literal["INFO", "WARNING", "ERROR"]


class MessageSchema(NamedTuple):
    """The name, encoding and definition of a schema, and the encoding of its messages."""

    name: str
    encoding: str
    data: bytes
    message_encoding: str


@contextmanager
def new_recording(target: Path, profile: str = "", *, replace: bool = False) -> Iterator[RecordingAuthor]:
    """Write a recording to `target`; it appears on a clean exit, complete.

    `profile` is that of its header, such as "ros2". Raises OSError when the target cannot be written, or
    exists and is not to be replaced.
    """
    if not replace and target.exists():
        raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(target))
    with appearing(target) as path, path.open("wb") as file:
        # Without summary offsets: the package writes empty groups, which `mcap doctor` reports as errors.
        writer = Writer(file, compression=CompressionType.ZSTD, use_summary_offsets=False)
        writer.start(profile=profile, library=f"lsnet-pipe {app_version()}")
        yield RecordingAuthor(writer)
        writer.finish()  # type: ignore[no-untyped-call]


class RecordingAuthor:
    """Appends messages to a new recording; by default stamp, log time and publish time are the same."""

    def __init__(self, writer: Writer) -> None:
        self._writer = writer
        self._schema_ids: dict[str, int] = {}
        self._channel_ids: dict[str, int] = {}
        self._copied_schema_ids: dict[tuple[str, str, bytes], int] = {}
        self._copied_channel_ids: dict[int, int] = {}

    def write_image(
        self,
        topic: str,
        time_ns: int,
        frame_id: str,
        data: bytes,
        image_format: str,
        *,
        stamp_ns: int | None = None,
        is_photograph: bool = False,
    ) -> None:
        """Append an encoded image as foxglove.CompressedImage; `image_format` is "jpeg", "png" or "webp".

        stamp_ns: the image's own stamp where the camera's clock is another.
        """
        message = CompressedImage(frame_id=frame_id, data=data, format=image_format)
        message.timestamp.FromNanoseconds(time_ns if stamp_ns is None else stamp_ns)
        self._write(topic, time_ns, message, {SOURCE_KEY: PHOTOGRAPHS} if is_photograph else {})

    def write_video(self, topic: str, time_ns: int, frame_id: str, data: bytes, codec: str) -> None:
        """Append a picture of an Annex B video as foxglove.CompressedVideo; `codec` is "h264" or "h265"."""
        message = CompressedVideo(frame_id=frame_id, data=data, format=codec)
        message.timestamp.FromNanoseconds(time_ns)
        self._write(topic, time_ns, message)

    def write_attitude(
        self,
        topic: str,
        time_ns: int,
        parent_frame_id: str,
        child_frame_id: str,
        rotation: Quaternion,
        *,
        translation_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> None:
        """Append the rotation of a frame in its parent, and its place, as foxglove.FrameTransform."""
        message = FrameTransform(parent_frame_id=parent_frame_id, child_frame_id=child_frame_id)
        message.rotation.w, message.rotation.x, message.rotation.y, message.rotation.z = rotation
        message.translation.x, message.translation.y, message.translation.z = translation_m
        message.timestamp.FromNanoseconds(time_ns)
        self._write(topic, time_ns, message)

    def write_location(
        self,
        topic: str,
        time_ns: int,
        frame_id: str,
        *,
        latitude_deg: float,
        longitude_deg: float,
        altitude_m: float,
    ) -> None:
        """Append a position (WGS 84, metres above the ellipsoid) as foxglove.LocationFix."""
        message = LocationFix(
            frame_id=frame_id, latitude=latitude_deg, longitude=longitude_deg, altitude=altitude_m
        )
        message.timestamp.FromNanoseconds(time_ns)
        self._write(topic, time_ns, message)

    def write_calibration(
        self,
        topic: str,
        time_ns: int,
        frame_id: str,
        *,
        image_size: tuple[int, int],
        focal_px: tuple[float, float],
        centre_px: tuple[float, float],
        distortion: Sequence[float] = (),
        is_nominal: bool = False,
    ) -> None:
        """Append a pinhole camera as foxglove.CameraCalibration.

        image_size is (height, width); focal_px and centre_px are (x, y), the centre counted from the
        top-left corner; distortion holds the plumb_bob coefficients k1, k2, p1, p2, k3, or nothing.
        is_nominal: the lens is as its maker states it, and was not measured.
        """
        (height, width), (fx, fy), (cx, cy) = image_size, focal_px, centre_px
        # Calibrations count from the centre of the top-left pixel.
        cx, cy = cx - 0.5, cy - 0.5
        message = CameraCalibration(
            frame_id=frame_id,
            width=width,
            height=height,
            distortion_model="plumb_bob",
            D=distortion or [0.0] * 5,
            K=[fx, 0, cx, 0, fy, cy, 0, 0, 1],
            R=[1, 0, 0, 0, 1, 0, 0, 0, 1],
            P=[fx, 0, cx, 0, 0, fy, cy, 0, 0, 0, 1, 0],
        )
        message.timestamp.FromNanoseconds(time_ns)
        self._write(topic, time_ns, message, {SOURCE_KEY: NOMINAL} if is_nominal else {})

    def write_geojson(self, topic: str, time_ns: int, text: str) -> None:
        """Append a map as foxglove.GeoJSON."""
        self._write(topic, time_ns, GeoJSON(geojson=text))

    def write_log(self, topic: str, time_ns: int, level: LogLevel, name: str, text: str) -> None:
        """Append a line of a log as foxglove.Log; `name` is that of what it comes from."""
        message = Log(level=Log.Level.Value(level), name=name, message=text)
        message.timestamp.FromNanoseconds(time_ns)
        self._write(topic, time_ns, message)

    def add_metadata(self, name: str, metadata: Mapping[str, str]) -> None:
        """Append a Metadata record."""
        self._writer.add_metadata(name, dict(metadata))

    def add_attachment(self, attachment: Attachment) -> None:
        """Append an attachment of another recording."""
        self._writer.add_attachment(
            attachment.create_time,
            attachment.log_time,
            attachment.name,
            attachment.media_type,
            attachment.data,
        )

    def copy_channel(self, source_id: int, channel: Channel, schema: Schema | None) -> None:
        """Add a channel of another recording, which `copy_message` knows by `source_id`."""
        schema_id = self._copied_schema_id(schema) if schema else 0
        self._copied_channel_ids[source_id] = self._writer.register_channel(
            channel.topic, channel.message_encoding, schema_id, channel.metadata
        )

    def copy_message(self, source_id: int, log_time_ns: int, publish_time_ns: int, data: bytes) -> None:
        """Append a message of another recording to a channel added by `copy_channel`."""
        self._writer.add_message(self._copied_channel_ids[source_id], log_time_ns, data, publish_time_ns)

    def _copied_schema_id(self, schema: Schema) -> int:
        key = (schema.name, schema.encoding, schema.data)
        if key not in self._copied_schema_ids:
            self._copied_schema_ids[key] = self._writer.register_schema(*key)
        return self._copied_schema_ids[key]

    def write_encoded(self, topic: str, time_ns: int, schema: MessageSchema, data: bytes) -> None:
        """Append a message that is encoded already."""
        if topic not in self._channel_ids:
            if schema.name not in self._schema_ids:
                self._schema_ids[schema.name] = self._writer.register_schema(
                    schema.name, schema.encoding, schema.data
                )
            self._channel_ids[topic] = self._writer.register_channel(
                topic, schema.message_encoding, self._schema_ids[schema.name]
            )
        self._writer.add_message(self._channel_ids[topic], time_ns, data, publish_time=time_ns)

    def _write(
        self, topic: str, time_ns: int, message: Message, metadata: Mapping[str, str] = MappingProxyType({})
    ) -> None:
        """Append a message; `metadata` are those of its channel when it is new."""
        if topic not in self._channel_ids:
            schema_id = self._schema_id(message)
            self._channel_ids[topic] = self._writer.register_channel(
                topic, "protobuf", schema_id, dict(metadata)
            )
        self._writer.add_message(
            self._channel_ids[topic], time_ns, message.SerializeToString(), publish_time=time_ns
        )

    def _schema_id(self, message: Message) -> int:
        descriptor = message.DESCRIPTOR
        if descriptor.full_name not in self._schema_ids:
            self._schema_ids[descriptor.full_name] = self._writer.register_schema(
                descriptor.full_name, "protobuf", file_descriptor_set(cast("FileDescriptor", descriptor.file))
            )
        return self._schema_ids[descriptor.full_name]
