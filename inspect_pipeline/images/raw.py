"""Raw images to pixels: the encodings of sensor_msgs, of Foxglove and of GenICam."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np

from inspect_pipeline.images.pixels import Pixels, ToRgb, conversion
from inspect_pipeline.messages.image import ImageError

if TYPE_CHECKING:
    from numpy.typing import DTypeLike

    from inspect_pipeline.arrays import ImageArray
    from inspect_pipeline.messages.image import RawLayout


class _Packed(NamedTuple):
    """An encoding with all channels of a pixel side by side, and the conversion to RGB."""

    dtype: DTypeLike
    n_channels: int
    to_rgb: ToRgb | None


_BGR, _BGRA, _RGBA, _GREY = (
    conversion(getattr(cv2, f"COLOR_{name}2RGB")) for name in ("BGR", "BGRA", "RGBA", "GRAY")
)
_PACKED = {
    "rgb8": _Packed(np.uint8, 3, None),
    "bgr8": _Packed(np.uint8, 3, _BGR),
    "8uc3": _Packed(np.uint8, 3, _BGR),
    "rgba8": _Packed(np.uint8, 4, _RGBA),
    "bgra8": _Packed(np.uint8, 4, _BGRA),
    "8uc4": _Packed(np.uint8, 4, _BGRA),
    "mono8": _Packed(np.uint8, 1, _GREY),
    "8uc1": _Packed(np.uint8, 1, _GREY),
    "rgb16": _Packed(np.uint16, 3, None),
    "bgr16": _Packed(np.uint16, 3, _BGR),
    "16uc3": _Packed(np.uint16, 3, _BGR),
    "rgba16": _Packed(np.uint16, 4, _RGBA),
    "bgra16": _Packed(np.uint16, 4, _BGRA),
    "16uc4": _Packed(np.uint16, 4, _BGRA),
    "mono10": _Packed(np.uint16, 1, _GREY),
    "mono12": _Packed(np.uint16, 1, _GREY),
    "mono14": _Packed(np.uint16, 1, _GREY),
    "mono16": _Packed(np.uint16, 1, _GREY),
    "16uc1": _Packed(np.uint16, 1, _GREY),
} | {
    name: _Packed(dtype, 1, conversion(getattr(cv2, f"COLOR_Bayer{pattern.upper()}2RGB")))
    for pattern in ("rggb", "bggr", "gbrg", "grbg")
    for bits, dtype in ((8, np.uint8), (10, np.uint16), (12, np.uint16), (16, np.uint16))
    for name in (f"bayer_{pattern}{bits}", f"bayer{pattern[:2]}{bits}")  # of ROS and of GenICam
}
# Two bytes a pixel; chroma is shared by two pixels side by side.
_YUV_422 = {
    "uyvy": cv2.COLOR_YUV2RGB_UYVY,
    "yuv422": cv2.COLOR_YUV2RGB_UYVY,
    "yuyv": cv2.COLOR_YUV2RGB_YUY2,
    "yuy2": cv2.COLOR_YUV2RGB_YUY2,
    "yuv422_yuy2": cv2.COLOR_YUV2RGB_YUY2,
}
# Rows of luma, then rows of chroma in pairs, which is shared by 2x2 pixels.
_YUV_420_PAIRS = {"nv12": cv2.COLOR_YUV2RGB_NV12, "nv21": cv2.COLOR_YUV2RGB_NV21}
# Planes of luma and of each chroma, which is shared by 2x2 pixels.
_YUV_420_PLANES = {
    "i420": cv2.COLOR_YUV2RGB_I420,
    "yuv420": cv2.COLOR_YUV2RGB_I420,
    "yv12": cv2.COLOR_YUV2RGB_YV12,
}
# R, G, B from Y, U, V and 1 by BT.601 in limited range, as OpenCV converts the others.
_BT_601 = np.array(
    [
        [1.164, 0.0, 1.596, -16 * 1.164 - 128 * 1.596],
        [1.164, -0.391, -0.813, -16 * 1.164 + 128 * (0.391 + 0.813)],
        [1.164, 2.018, 0.0, -16 * 1.164 - 128 * 2.018],
    ]
)


def is_raw_encoding(encoding: str) -> bool:
    """Whether a pixel encoding can be decoded."""
    name = _plain(encoding)
    return name == "nv24" or any(
        name in known for known in (_PACKED, _YUV_422, _YUV_420_PAIRS, _YUV_420_PLANES)
    )


def decode_raw(encoding: str, layout: RawLayout, data: ImageArray) -> Pixels:
    """Unpack a raw image; data are its bytes. Raises ImageError."""
    name = _plain(encoding)
    if name in _PACKED:
        return _decode_packed(_PACKED[name], layout, data)
    if name in _YUV_422:
        return _decode_yuv_422(_YUV_422[name], layout, data)
    if name in _YUV_420_PAIRS:
        return _decode_yuv_420_pairs(_YUV_420_PAIRS[name], layout, data)
    if name in _YUV_420_PLANES:
        return _decode_yuv_420_planes(_YUV_420_PLANES[name], layout, data)
    if name == "nv24":
        return _decode_nv24(layout, data)
    raise ImageError(f"the pixel encoding {encoding!r} is not known")


def _plain(encoding: str) -> str:
    return encoding.strip().lower()


def _decode_packed(packed: _Packed, layout: RawLayout, data: ImageArray) -> Pixels:
    dtype = np.dtype(packed.dtype).newbyteorder(">" if layout.is_big_endian else "<")
    rows = _rows(layout, data, layout.height, layout.width * packed.n_channels * dtype.itemsize)
    values = rows.view(dtype).astype(packed.dtype, copy=False)
    if packed.n_channels > 1:
        values = values.reshape(layout.height, layout.width, packed.n_channels)
    return Pixels(values, packed.to_rgb)


def _decode_yuv_422(code: int, layout: RawLayout, data: ImageArray) -> Pixels:
    values = _rows(layout, data, layout.height, layout.width * 2).reshape(layout.height, layout.width, 2)
    return Pixels(values, lambda yuv: _at_even_size(yuv, code, layout))


def _at_even_size(yuv: ImageArray, code: int, layout: RawLayout) -> ImageArray:
    """Convert an image of odd width, which OpenCV does not, with its last pair of columns repeated."""
    if layout.width % 2:
        yuv = np.concatenate([yuv, yuv[:, -2:-1] if layout.width > 1 else yuv], axis=1)
    return np.asarray(cv2.cvtColor(yuv, code), np.uint8)[:, : layout.width]


def _decode_yuv_420_pairs(code: int, layout: RawLayout, data: ImageArray) -> Pixels:
    height, width = layout.height, layout.width
    even_height, even_width = height + height % 2, width + width % 2
    rows = _rows(layout, data, height + even_height // 2, even_width if layout.step_bytes != width else width)
    luma = np.pad(rows[:height, :width], ((0, even_height - height), (0, even_width - width)), mode="edge")
    chroma = np.pad(rows[height:], ((0, 0), (0, even_width - rows.shape[1])), mode="edge")
    return Pixels(
        np.concatenate([luma, chroma]),
        lambda yuv: np.asarray(cv2.cvtColor(yuv, code), np.uint8)[:height, :width],
    )


def _decode_yuv_420_planes(code: int, layout: RawLayout, data: ImageArray) -> Pixels:
    if layout.width % 4 or layout.height % 2 or layout.step_bytes not in {0, layout.width}:
        raise ImageError("planes of chroma are read of even sizes without padding only")
    return Pixels(_rows(layout, data, layout.height * 3 // 2, layout.width), conversion(code))


def _decode_nv24(layout: RawLayout, data: ImageArray) -> Pixels:
    """Unpack rows of luma, then pairs of chroma for every pixel, two rows' worth of bytes a row."""
    rows = _rows(layout, data, layout.height * 3, layout.width)
    chroma = rows[layout.height :].reshape(layout.height, layout.width, 2)
    yuv = np.dstack([rows[: layout.height], chroma])
    return Pixels(yuv, lambda values: np.asarray(cv2.transform(values, _BT_601), np.uint8))


def _rows(layout: RawLayout, data: ImageArray, n_rows: int, row_bytes: int) -> ImageArray:
    """Return the rows of a raw image without padding: (n_rows, row_bytes). The last one may lack its own.

    A step that contradicts data that are exactly as long as the rows is ignored.
    """
    step_bytes = layout.step_bytes or row_bytes
    if len(data) == n_rows * row_bytes:
        step_bytes = row_bytes
    n_bytes = (n_rows - 1) * step_bytes + row_bytes
    if not 0 < row_bytes <= step_bytes or n_rows < 1 or n_bytes > len(data):
        raise ImageError("the image is smaller than its size says")
    rows = np.lib.stride_tricks.as_strided(data[:n_bytes], (n_rows, row_bytes), (step_bytes, 1))
    return np.ascontiguousarray(rows)
