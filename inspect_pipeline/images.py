"""Image messages to pixels: one table of the kinds that are read, in one place.

`parse` takes an image message apart, `decode` makes RGB of it. Which codec an image has is told by its
first bytes, not by the message's `format`, about which recorders disagree ("jpeg", "image/jpeg",
"rgb8; jpeg compressed bgr8").
"""

from __future__ import annotations

import base64
import binascii
import json
import re
import struct
from dataclasses import dataclass
from datetime import datetime
from typing import TYPE_CHECKING

import cv2
import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from google.protobuf.message import DecodeError

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

    from numpy.typing import NDArray


class ImageError(ValueError):
    """Raised when one image cannot be read; the message is a short phrase."""


@dataclass(frozen=True, slots=True, eq=False)
class ImageMessage:
    """An image message taken apart: the header stamp, the frame id and the encoded image."""

    stamp_ns: int
    frame_id: str
    format: str
    data: bytes | memoryview


def is_image(schema_name: str, message_encoding: str) -> bool:
    """Whether messages of this schema in this encoding are images that can be read."""
    return (schema_name, message_encoding) in _PARSERS


def parse(schema_name: str, message_encoding: str, payload: memoryview) -> ImageMessage:
    """Take an image message apart. Raises ImageError when it is malformed, KeyError when it is no image."""
    parser = _PARSERS[schema_name, message_encoding]
    try:
        return parser(payload)
    except (ValueError, LookupError, TypeError, struct.error, RecursionError, DecodeError) as error:
        raise ImageError(f"the message is not a {schema_name}") from error


def is_depth(message: ImageMessage, topic: str) -> bool:
    """Whether the images of a topic hold distances instead of colours, by one of them."""
    return "compresseddepth" in message.format.lower() or topic.endswith("/compressedDepth")


def decode(message: ImageMessage) -> NDArray[np.uint8]:
    """The pixels as stored, EXIF orientation ignored: uint8 (height, width, 3) RGB. Raises ImageError."""
    data = np.frombuffer(message.data, np.uint8)
    if not len(data):
        raise ImageError("the image is empty")
    try:
        image = cv2.imdecode(data, cv2.IMREAD_COLOR_RGB | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error as error:
        raise ImageError("the image cannot be decoded") from error
    if image is None:
        raise ImageError("the image cannot be decoded")
    return image.astype(np.uint8, copy=False)


def _parse_protobuf(payload: memoryview) -> ImageMessage:
    message = CompressedImage.FromString(bytes(payload))
    return ImageMessage(message.timestamp.ToNanoseconds(), message.frame_id, message.format, message.data)


def _parse_json(payload: memoryview) -> ImageMessage:
    fields: dict[str, Any] = json.loads(bytes(payload))
    try:
        data = base64.b64decode(fields["data"], validate=True)
    except binascii.Error as error:
        raise ImageError("the image is not valid base64") from error
    stamp_ns = _json_time_ns(fields.get("timestamp", {}))
    return ImageMessage(stamp_ns, str(fields.get("frame_id", "")), str(fields.get("format", "")), data)


def _json_time_ns(time: Any) -> int:
    """A time in JSON: {"sec", "nsec"} by Foxglove's JSON Schema, or an RFC 3339 string as in protobuf."""
    if isinstance(time, str):
        match = re.fullmatch(r"(.+?)(?:\.(\d{1,9}))?(Z|[+-]\d\d:\d\d)", time)
        if match is None:
            raise ValueError(time)
        whole = datetime.fromisoformat(match[1] + match[3])
        return int(whole.timestamp()) * 1_000_000_000 + int((match[2] or "").ljust(9, "0"))
    return int(time.get("sec", 0)) * 1_000_000_000 + int(time.get("nsec", 0))


class _Cdr:
    """Reads the fields of a CDR message (XCDR1) in order; alignment counts from behind the 4-byte head."""

    def __init__(self, payload: memoryview) -> None:
        self._payload = payload
        self._order = "<" if payload[1] & 1 else ">"
        self._at = 4

    def uint32(self) -> int:
        at = self._at + -self._at % 4
        self._at = at + 4
        value: int = struct.unpack_from(self._order + "I", self._payload, at)[0]
        return value

    def blob(self) -> memoryview:
        length = self.uint32()
        start, self._at = self._at, self._at + length
        if self._at > len(self._payload):
            raise ValueError("a field overruns the message")
        return self._payload[start : self._at]

    def string(self) -> str:
        return bytes(self.blob()).rstrip(b"\0").decode()


def _parse_ros2(payload: memoryview) -> ImageMessage:
    cdr = _Cdr(payload)
    stamp_ns = cdr.uint32() * 1_000_000_000 + cdr.uint32()
    return ImageMessage(stamp_ns, frame_id=cdr.string(), format=cdr.string(), data=cdr.blob())


_PARSERS: dict[tuple[str, str], Callable[[memoryview], ImageMessage]] = {
    ("foxglove.CompressedImage", "protobuf"): _parse_protobuf,
    ("foxglove.CompressedImage", "json"): _parse_json,
    ("sensor_msgs/msg/CompressedImage", "cdr"): _parse_ros2,
}
