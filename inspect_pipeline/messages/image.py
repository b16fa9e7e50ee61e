"""Image messages, parsed whatever their schema and encoding.

`_PARSERS` lists what is read: Foxglove's CompressedImage, CompressedVideo and RawImage in protobuf, JSON,
FlatBuffers and CDR; CompressedImage and Image of sensor_msgs in ROS 1 and CDR; FFMPEGPacket in CDR.
"""

from __future__ import annotations

import base64
import binascii
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
from inspect_pipeline.messages.names import type_name

if TYPE_CHECKING:
    from collections.abc import Callable

    from inspect_pipeline.messages.cdr import SequentialReader

_MAX_STAMP_NS = (1 << 63) - 1  # the year 2262; a later stamp, or one before 1970, is damage
_VIDEO_START_CODES = (b"\0\0\0\1", b"\0\0\1")
_PICTURE_HEADS = (b"\xff\xd8\xff", b"\x89PNG", b"RIFF", b"GIF8", b"II*\0", b"MM\0*")  # JPEG, PNG, WebP, ...
_ZSTD_HEAD = b"\x28\xb5\x2f\xfd"
_CODEC_WORDS = {
    "h264": re.compile(r"[hx]\.?264|avc"),
    "hevc": re.compile(r"[hx]\.?265|hevc|hvc1|hev1"),
    "vp8": re.compile(r"vp0?8"),
    "vp9": re.compile(r"vp0?9"),
    "av1": re.compile(r"av0?1"),
}
_IMAGE_TYPES = re.compile(r"(Image|Video|Packet)$")


class ImageError(ValueError):
    """Raised when one image cannot be read; the message is a short phrase."""


@dataclass(frozen=True, slots=True)
class RawLayout:
    """How the pixels of a raw image are arranged in its data."""

    height: int
    width: int
    step_bytes: int  # from one row to the next
    is_big_endian: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class ImageMessage:
    """A parsed image message.

    Attributes:
        stamp_ns: the header stamp; 0 when it is missing or absurd.
        frame_id: of the header.
        encoding: as the message spells it: a pixel encoding such as "bgr8" of a raw image, else a format such
            as "jpeg" or "h264".
        data: the image.
        raw: None when the image is compressed.
        is_video: whether it is a packet of a video, which can only be decoded after those before it.
    """

    stamp_ns: int
    frame_id: str
    encoding: str
    data: bytes | memoryview
    raw: RawLayout | None = None
    is_video: bool = False


def is_image(schema_name: str, message_encoding: str) -> bool:
    """Whether messages of this schema in this encoding are images that can be read."""
    return (type_name(schema_name), message_encoding) in _PARSERS


def looks_like_image(schema_name: str) -> bool:
    """Whether a schema is, by its name, one of images, readable or not."""
    return bool(_IMAGE_TYPES.search(schema_name))


def parse(schema_name: str, message_encoding: str, payload: memoryview) -> ImageMessage:
    """Parse an image message. Raises ImageError when it is malformed, KeyError when it is not an image."""
    parser = _PARSERS[type_name(schema_name), message_encoding]
    if payload[:4] == _ZSTD_HEAD:
        raise ImageError("the message is compressed with zstd; decompress the recording: ros2 bag convert")
    try:
        message = parser(payload)
    except MALFORMED as error:
        raise ImageError(f"the message is not a {schema_name}") from error
    if not 0 <= message.stamp_ns <= _MAX_STAMP_NS:
        message = replace(message, stamp_ns=0)
    return replace(message, is_video=message.raw is None and _is_video(schema_name, message))


def is_picture(data: bytes | memoryview) -> bool:
    """Whether data begin like an image file."""
    return bytes(data[:4]).startswith(_PICTURE_HEADS)


def codec_named(encoding: str) -> str | None:
    """Return the video codec that a message names: h264, hevc, vp8, vp9, av1; None for other formats."""
    name = encoding.lower()
    return next((codec for codec, words in _CODEC_WORDS.items() if words.search(name)), None)


def _is_video(schema_name: str, message: ImageMessage) -> bool:
    """Whether a compressed image is video: by its first bytes, else by its schema and format."""
    if is_picture(message.data):
        return False
    is_video_schema = schema_name.endswith(("Video", "Packet"))
    return (
        bytes(message.data[:4]).startswith(_VIDEO_START_CODES)
        or is_video_schema
        or codec_named(message.encoding) is not None
    )


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
    return ImageMessage(*_json_head(fields), str(fields.get("format", "")), _json_data(fields["data"]))


def _json_raw(payload: memoryview) -> ImageMessage:
    fields: dict[str, Any] = json.loads(bytes(payload))
    layout = RawLayout(int(fields["height"]), int(fields["width"]), int(fields["step"]))
    return ImageMessage(*_json_head(fields), str(fields["encoding"]), _json_data(fields["data"]), layout)


def _json_head(fields: dict[str, Any]) -> tuple[int, str]:
    frame_id = str(fields.get("frame_id", "")).encode(errors="replace").decode()  # lone surrogates
    return _json_time_ns(fields.get("timestamp", {})), frame_id


def _json_data(text: Any) -> bytes:
    """Decode base64: plain, with line ends, of the URL-safe alphabet, without padding, or as a data URL."""
    try:
        return base64.b64decode(text, validate=True)
    except binascii.Error:
        plain = "".join(text.removeprefix("data:").rpartition(",")[2].split()).rstrip("=")
        plain += "=" * (-len(plain) % 4)
        return base64.b64decode(plain.translate({ord("-"): "+", ord("_"): "/"}), validate=True)


def _json_time_ns(time: Any) -> int:
    """Parse a time in JSON: {"sec", "nsec"} as in Foxglove's JSON Schema, or RFC 3339 as in protobuf."""
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


def _ffmpeg_packet(reader: SequentialReader) -> ImageMessage:
    """Parse the message of ffmpeg_image_transport, whose encoding is that of the encoder, such as libx264."""
    stamp_ns, frame_id = reader.header()
    for _ in ("width", "height"):
        reader.uint32()
    encoding = reader.string()
    reader.number("Q")  # pts
    for _ in ("flags", "is_bigendian"):
        reader.uint8()
    return ImageMessage(stamp_ns, frame_id, encoding, reader.blob())


def _foxglove_cdr_compressed(reader: SequentialReader) -> ImageMessage:
    stamp_ns, frame_id, data = reader.time_ns(), reader.string(), reader.blob()
    return ImageMessage(stamp_ns, frame_id, reader.string(), data)


def _foxglove_cdr_raw(reader: SequentialReader) -> ImageMessage:
    stamp_ns, frame_id = reader.time_ns(), reader.string()
    width, height, encoding, step_bytes = reader.uint32(), reader.uint32(), reader.string(), reader.uint32()
    return ImageMessage(stamp_ns, frame_id, encoding, reader.blob(), RawLayout(height, width, step_bytes))


def _with(
    reader: type[SequentialReader], parse_fields: Callable[[SequentialReader], ImageMessage]
) -> Callable[[memoryview], ImageMessage]:
    return lambda payload: parse_fields(reader(payload))


_PARSERS: dict[tuple[str, str], Callable[[memoryview], ImageMessage]] = {
    ("foxglove/CompressedImage", "protobuf"): _protobuf_compressed,
    ("foxglove/CompressedImage", "json"): _json_compressed,
    ("foxglove/CompressedImage", "flatbuffer"): _flatbuffer_compressed,
    ("foxglove/CompressedImage", "cdr"): _with(CdrReader, _foxglove_cdr_compressed),
    ("foxglove/CompressedVideo", "protobuf"): _protobuf_video,
    ("foxglove/CompressedVideo", "json"): _json_compressed,
    ("foxglove/CompressedVideo", "flatbuffer"): _flatbuffer_compressed,
    ("foxglove/CompressedVideo", "cdr"): _with(CdrReader, _foxglove_cdr_compressed),
    ("foxglove/RawImage", "protobuf"): _protobuf_raw,
    ("foxglove/RawImage", "json"): _json_raw,
    ("foxglove/RawImage", "flatbuffer"): _flatbuffer_raw,
    ("foxglove/RawImage", "cdr"): _with(CdrReader, _foxglove_cdr_raw),
    ("sensor_msgs/CompressedImage", "cdr"): _with(CdrReader, _ros_compressed),
    ("sensor_msgs/CompressedImage", "ros1"): _with(Ros1Reader, _ros_compressed),
    ("sensor_msgs/Image", "cdr"): _with(CdrReader, _ros_raw),
    ("sensor_msgs/Image", "ros1"): _with(Ros1Reader, _ros_raw),
    ("ffmpeg_image_transport_msgs/FFMPEGPacket", "cdr"): _with(CdrReader, _ffmpeg_packet),
}
