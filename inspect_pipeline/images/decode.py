"""Images to pixels: whatever a message holds becomes uint8 RGB.

Which codec a compressed image has is told by its first bytes, not by the message's `format`, about which
recorders disagree ("jpeg", "image/jpeg", "rgb8; jpeg compressed bgr8"). How raw pixels are made RGB is one
table, `_RAW`.
"""

from __future__ import annotations

import logging
import struct
import warnings
import zlib
from io import BytesIO
from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np
from PIL import Image

from inspect_pipeline.images.video import can_decode
from inspect_pipeline.messages.image import ImageError, ImageMessage, is_image, parse

if TYPE_CHECKING:
    from numpy.typing import DTypeLike

    from inspect_pipeline.arrays import ImageArray
    from inspect_pipeline.messages.image import RawLayout

__all__ = ["ImageError", "ImageMessage", "decode", "is_image", "parse", "refusal"]

# Claims beyond these are damage or an attack.
_MAX_PIXELS = 160 << 20  # cameras have up to 150 megapixels
_MAX_PIXELS_PER_BYTE = 10_000  # a PNG of one bit and one colour has 8,256
_SMALL_PIXELS = 4 << 20
_JPEG, _PNG = b"\xff\xd8\xff", b"\x89PNG\r\n\x1a\n"
_JPEG_FRAME_MARKERS = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}

# What is wrong with an image stands in its frame; neither library needs to tell it to stderr.
cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
logging.getLogger("PIL").setLevel(logging.CRITICAL + 1)
warnings.filterwarnings("ignore", module="PIL")


class _Raw(NamedTuple):
    """How a pixel encoding lies in memory, and the OpenCV conversion to RGB."""

    dtype: DTypeLike
    n_channels: int
    to_rgb: int | None


_RAW = {
    "rgb8": _Raw(np.uint8, 3, None),
    "bgr8": _Raw(np.uint8, 3, cv2.COLOR_BGR2RGB),
    "8UC3": _Raw(np.uint8, 3, cv2.COLOR_BGR2RGB),
    "rgba8": _Raw(np.uint8, 4, cv2.COLOR_RGBA2RGB),
    "bgra8": _Raw(np.uint8, 4, cv2.COLOR_BGRA2RGB),
    "8UC4": _Raw(np.uint8, 4, cv2.COLOR_BGRA2RGB),
    "mono8": _Raw(np.uint8, 1, cv2.COLOR_GRAY2RGB),
    "8UC1": _Raw(np.uint8, 1, cv2.COLOR_GRAY2RGB),
    "mono16": _Raw(np.uint16, 1, cv2.COLOR_GRAY2RGB),
    "16UC1": _Raw(np.uint16, 1, cv2.COLOR_GRAY2RGB),
    "yuv422": _Raw(np.uint8, 2, cv2.COLOR_YUV2RGB_UYVY),
    "uyvy": _Raw(np.uint8, 2, cv2.COLOR_YUV2RGB_UYVY),
    "yuv422_yuy2": _Raw(np.uint8, 2, cv2.COLOR_YUV2RGB_YUY2),
    "yuyv": _Raw(np.uint8, 2, cv2.COLOR_YUV2RGB_YUY2),
    "nv12": _Raw(np.uint8, 1, cv2.COLOR_YUV2RGB_NV12),
} | {
    f"bayer_{pattern}{bits}": _Raw(dtype, 1, getattr(cv2, f"COLOR_Bayer{pattern.upper()}2RGB"))
    for pattern in ("rggb", "bggr", "gbrg", "grbg")
    for bits, dtype in ((8, np.uint8), (16, np.uint16))
}


def refusal(message: ImageMessage, topic: str) -> str | None:
    """Say why the images of a topic are not processed, by one of them; None when they are pictures."""
    if _is_depth(message.encoding, topic):
        return "it holds distances"
    if message.raw is None:
        needs_video = message.is_video and not can_decode()
        return "it holds video, which needs the extra 'video'" if needs_video else None
    return None if message.encoding in _RAW else f"its pixel encoding {message.encoding!r} is not known"


def _is_depth(encoding: str, topic: str) -> bool:
    """Whether an image holds distances: "16UC1" or "16UC1; png compressed" on a depth topic."""
    pixels = encoding.split(";", maxsplit=1)[0].strip()
    if "compresseddepth" in encoding.lower() or topic.endswith("/compressedDepth") or pixels == "32FC1":
        return True
    return pixels in {"16UC1", "mono16"} and "depth" in topic.lower()


def decode(message: ImageMessage) -> ImageArray:
    """The pixels as stored, EXIF orientation ignored: uint8 (height, width, 3) RGB. Raises ImageError."""
    if not message.data:
        raise ImageError("the image is empty")
    if message.is_video:
        raise ImageError("the image is a piece of video")
    try:
        if message.raw is None:
            return _decode_compressed(np.frombuffer(message.data, np.uint8))
        return _decode_raw(message.encoding, message.raw, np.frombuffer(message.data, np.uint8))
    except cv2.error as error:
        raise ImageError("the image cannot be decoded") from error


def _decode_compressed(data: ImageArray) -> ImageArray:
    n_pixels = _claimed_pixels(memoryview(data.data))
    if n_pixels > _MAX_PIXELS:
        raise ImageError(f"the image claims more than {_MAX_PIXELS >> 20} megapixels")
    if n_pixels > max(_MAX_PIXELS_PER_BYTE * len(data), _SMALL_PIXELS):
        raise ImageError("the image claims more pixels than its bytes can hold")
    image = cv2.imdecode(data, cv2.IMREAD_COLOR_RGB | cv2.IMREAD_IGNORE_ORIENTATION)
    if image is None:
        raise ImageError("the image cannot be decoded")
    return image.astype(np.uint8, copy=False)


def _claimed_pixels(view: memoryview) -> int:
    """Width times height by the head of an image, before memory is taken for it; 0 when unknown.

    Raises ImageError for a damaged PNG.
    """
    if view[:8] == _PNG:
        _check_png(view)
        return int.from_bytes(view[16:20]) * int.from_bytes(view[20:24])
    if view[:3] != _JPEG:
        return _claimed_to_pillow(view)
    at = 2
    while at + 9 <= len(view) and view[at] == 0xFF:
        marker, length, _, height, width = struct.unpack_from(">xBHBHH", view, at)
        if marker in _JPEG_FRAME_MARKERS:
            return int(height * width)
        at += 2 + length
    return 0


def _check_png(view: memoryview) -> None:
    """Find the damage before OpenCV does, which would take the memory it claims, and talk to stderr.

    What stands behind the last chunk is not looked at: some recorders pad.
    """
    at, kind = 8, b""
    while at < len(view) and kind != b"IEND":
        end = at + 8 + int.from_bytes(view[at : at + 4])
        if end + 4 > len(view):
            raise ImageError("the image is cut off")
        if zlib.crc32(view[at + 4 : end]) != int.from_bytes(view[end : end + 4]):
            raise ImageError("the image does not match its CRC")
        at, kind = end + 4, bytes(view[at + 4 : at + 8])


def _claimed_to_pillow(view: memoryview) -> int:
    """The same of formats whose heads are less simple; Pillow reads no further than those."""
    try:
        with Image.open(BytesIO(view)) as image:
            return image.width * image.height
    except Image.DecompressionBombError:
        return _MAX_PIXELS + 1
    except Exception:  # its readers raise whatever a damaged head makes them
        return 0


def _decode_raw(encoding: str, layout: RawLayout, data: ImageArray) -> ImageArray:
    raw = _RAW.get(encoding)
    if raw is None:
        raise ImageError(f"the pixel encoding {encoding!r} is not known")
    n_rows = layout.height * 3 // 2 if encoding == "nv12" else layout.height
    rows = _rows(layout, data, n_rows, layout.width * raw.n_channels * np.dtype(raw.dtype).itemsize)
    pixels = rows.view(np.dtype(raw.dtype).newbyteorder(">" if layout.is_big_endian else "<"))
    if raw.dtype is np.uint16:
        pixels = (pixels >> 8).astype(np.uint8)
    if raw.n_channels > 1:
        pixels = pixels.reshape(n_rows, layout.width, raw.n_channels)
    image = pixels if raw.to_rgb is None else cv2.cvtColor(pixels, raw.to_rgb)
    return np.ascontiguousarray(image, np.uint8)


def _rows(layout: RawLayout, data: ImageArray, n_rows: int, row_bytes: int) -> ImageArray:
    """The rows of a raw image without their padding: (n_rows, row_bytes). The last row may lack its own."""
    step_bytes = layout.step_bytes or row_bytes
    n_bytes = (n_rows - 1) * step_bytes + row_bytes
    if not 0 < row_bytes <= step_bytes or n_rows < 1 or n_bytes > len(data):
        raise ImageError("the image is smaller than its size says")
    rows = np.lib.stride_tricks.as_strided(data[:n_bytes], (n_rows, row_bytes), (step_bytes, 1))
    return np.ascontiguousarray(rows)
