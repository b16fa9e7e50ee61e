"""Image messages taken apart, whatever their schema and encoding.

One table, `_PARSERS`, lists what is read: Foxglove's CompressedImage, CompressedVideo and RawImage in
protobuf, JSON, FlatBuffers and ROS 2, and CompressedImage and Image of sensor_msgs in ROS 1 and ROS 2.
"""

from __future__ import annotations

import base64
import json
import re
from dataclasses import dataclass, replace
from datetime import datetime
from typing import TYPE_CHECKING, Any

from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

from inspect_pipeline.messages.cdr import CdrReader, Ros1Reader
from inspect_pipeline.messages.errors import MALFORMED
from inspect_pipeline.messages.flatbuffer import FlatbufferTable

if TYPE_CHECKING:
    from collections.abc import Callable

    from inspect_pipeline.messages.cdr import SequentialReader

_MAX_STAMP_NS = (1 << 63) - 1  # the year 2262; what is later, or before 1970, is no stamp
_VIDEO_START_CODES = (b"\0\0\0\1", b"\0\0\1")
_VIDEO_FORMATS = re.compile(r"h\.?26[45]|hevc|avc|vp9|av1")
_PICTURE_HEADS = (b"\xff\xd8\xff", b"\x89PNG", b"RIFF", b"GIF8", b"II*\0", b"MM\0*")  # JPEG, PNG, WebP, ...


class ImageError(ValueError):
    """Raised when one image cannot be read; the message is a short phrase."""


@dataclass(frozen=True, slots=True)
class RawLayout:
    """How the pixels of a raw image lie in its data."""

    height: int
    width: int
    step_bytes: int  # from one row to the next
    is_big_endian: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class ImageMessage:
    """An image message taken apart.

    `encoding` is what the message calls it: a pixel encoding such as "bgr8" of a raw image, else a format
    such as "jpeg" or "h264". `raw` is None when the image is compressed. `is_video` is set when it is one
    of a video, which stands on those before it.
    """

    stamp_ns: int
    frame_id: str
    encoding: str
    data: bytes | memoryview
    raw: RawLayout | None = None
    is_video: bool = False


def is_image(schema_name: str, message_encoding: str) -> bool:
    """Whether messages of this schema in this encoding are images that can be read."""
    return (schema_name, message_encoding) in _PARSERS


def parse(schema_name: str, message_encoding: str, payload: memoryview) -> ImageMessage:
    """Take an image message apart. Raises ImageError when it is malformed, KeyError when it is no image."""
    parser = _PARSERS[schema_name, message_encoding]
    try:
        message = parser(payload)
    except MALFORMED as error:
        raise ImageError(f"the message is not a {schema_name}") from error
    if not 0 <= message.stamp_ns <= _MAX_STAMP_NS:
        message = replace(message, stamp_ns=0)
    return replace(message, is_video=message.raw is None and _is_video(schema_name, message))


def _is_video(schema_name: str, message: ImageMessage) -> bool:
    """Whether a compressed image is a piece of video: its first bytes say so, or do not say otherwise."""
    head = bytes(message.data[:4])
    if head.startswith(_PICTURE_HEADS):
        return False
    is_named = schema_name.endswith("Video") or _VIDEO_FORMATS.search(message.encoding.lower())
    return head.startswith(_VIDEO_START_CODES) or bool(is_named)


def _protobuf_compressed(payload: memoryview) -> ImageMessage:
    message = CompressedImage.FromString(bytes(payload))
    return ImageMessage(message.timestamp.ToNanoseconds(), message.frame_id, message.format, message.data)


def _protobuf_video(payload: memoryview) -> ImageMessage:
    message = CompressedVideo.FromString(bytes(payload))
    return ImageMessage(message.timestamp.ToNanoseconds(), message.frame_id, message.format, message.data)


def _protobuf_raw(payload: memoryview) -> ImageMessage:
    message = RawImage.FromString(bytes(payload))
    layout = RawLayout(message.height, message.width, message.step)
    stamp_ns = message.timestamp.ToNanoseconds()
    return ImageMessage(stamp_ns, message.frame_id, message.encoding, message.data, layout)


def _json_compressed(payload: memoryview) -> ImageMessage:
    fields: dict[str, Any] = json.loads(bytes(payload))
    return ImageMessage(*_json_head(fields), str(fields.get("format", "")), _json_data(fields))


def _json_raw(payload: memoryview) -> ImageMessage:
    fields: dict[str, Any] = json.loads(bytes(payload))
    layout = RawLayout(int(fields["height"]), int(fields["width"]), int(fields["step"]))
    return ImageMessage(*_json_head(fields), str(fields["encoding"]), _json_data(fields), layout)


def _json_head(fields: dict[str, Any]) -> tuple[int, str]:
    frame_id = str(fields.get("frame_id", "")).encode(errors="replace").decode()  # \ud800 is no text
    return _json_time_ns(fields.get("timestamp", {})), frame_id


def _json_data(fields: dict[str, Any]) -> bytes:
    return base64.b64decode(fields["data"], validate=True)


def _json_time_ns(time: Any) -> int:
    """A time in JSON: {"sec", "nsec"} by Foxglove's JSON Schema, or an RFC 3339 string as in protobuf."""
    if isinstance(time, str):
        match = re.fullmatch(r"(.+?)(?:\.(\d{1,9}))?(Z|[+-]\d\d:\d\d)", time)
        if match is None:
            raise ValueError(time)
        whole = datetime.fromisoformat(match[1] + match[3])
        return int(whole.timestamp()) * 1_000_000_000 + int((match[2] or "").ljust(9, "0"))
    return int(time.get("sec", 0)) * 1_000_000_000 + int(time.get("nsec", 0))


def _flatbuffer_compressed(payload: memoryview) -> ImageMessage:
    table = FlatbufferTable(payload)
    return ImageMessage(table.time_ns(0), table.string(1), encoding=table.string(3), data=table.blob(2))


def _flatbuffer_raw(payload: memoryview) -> ImageMessage:
    table = FlatbufferTable(payload)
    layout = RawLayout(height=table.uint32(3), width=table.uint32(2), step_bytes=table.uint32(5))
    return ImageMessage(table.time_ns(0), table.string(1), table.string(4), table.blob(6), layout)


def _ros_compressed(reader: SequentialReader) -> ImageMessage:
    stamp_ns, frame_id = reader.header()
    return ImageMessage(stamp_ns, frame_id, encoding=reader.string(), data=reader.blob())


def _ros_raw(reader: SequentialReader) -> ImageMessage:
    stamp_ns, frame_id = reader.header()
    height, width, encoding = reader.uint32(), reader.uint32(), reader.string()
    is_big_endian, step_bytes = bool(reader.uint8()), reader.uint32()
    return ImageMessage(
        stamp_ns, frame_id, encoding, reader.blob(), RawLayout(height, width, step_bytes, is_big_endian)
    )


def _foxglove_ros2_compressed(reader: SequentialReader) -> ImageMessage:
    stamp_ns, frame_id, data = reader.time_ns(), reader.string(), reader.blob()
    return ImageMessage(stamp_ns, frame_id, reader.string(), data)


def _foxglove_ros2_raw(reader: SequentialReader) -> ImageMessage:
    stamp_ns, frame_id = reader.time_ns(), reader.string()
    width, height, encoding, step_bytes = reader.uint32(), reader.uint32(), reader.string(), reader.uint32()
    return ImageMessage(stamp_ns, frame_id, encoding, reader.blob(), RawLayout(height, width, step_bytes))


def _by(
    reader: type[SequentialReader], take: Callable[[SequentialReader], ImageMessage]
) -> Callable[[memoryview], ImageMessage]:
    return lambda payload: take(reader(payload))


_PARSERS: dict[tuple[str, str], Callable[[memoryview], ImageMessage]] = {
    ("foxglove.CompressedImage", "protobuf"): _protobuf_compressed,
    ("foxglove.CompressedImage", "json"): _json_compressed,
    ("foxglove.CompressedImage", "flatbuffer"): _flatbuffer_compressed,
    ("foxglove.CompressedVideo", "protobuf"): _protobuf_video,
    ("foxglove.CompressedVideo", "json"): _json_compressed,
    ("foxglove.CompressedVideo", "flatbuffer"): _flatbuffer_compressed,
    ("foxglove.RawImage", "protobuf"): _protobuf_raw,
    ("foxglove.RawImage", "json"): _json_raw,
    ("foxglove.RawImage", "flatbuffer"): _flatbuffer_raw,
    ("foxglove_msgs/msg/CompressedImage", "cdr"): _by(CdrReader, _foxglove_ros2_compressed),
    ("foxglove_msgs/msg/CompressedVideo", "cdr"): _by(CdrReader, _foxglove_ros2_compressed),
    ("foxglove_msgs/msg/RawImage", "cdr"): _by(CdrReader, _foxglove_ros2_raw),
    ("sensor_msgs/msg/CompressedImage", "cdr"): _by(CdrReader, _ros_compressed),
    ("sensor_msgs/msg/Image", "cdr"): _by(CdrReader, _ros_raw),
    ("sensor_msgs/CompressedImage", "ros1"): _by(Ros1Reader, _ros_compressed),
    ("sensor_msgs/Image", "ros1"): _by(Ros1Reader, _ros_raw),
}
