"""Compressed images to pixels: JPEG by libjpeg-turbo, all other formats by Pillow.

The first bytes decide what an image is. Its size is read, and bounded, before memory is taken for it. Both
libraries report what is wrong as exceptions; OpenCV would leave warnings of libjpeg and libpng to stderr.
"""

from __future__ import annotations

import logging
import sys
import warnings
import zlib
from io import BytesIO
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import simplejpeg
from PIL import Image, ImageFile, UnidentifiedImageError

from inspect_pipeline.images.pixels import Pixels, conversion
from inspect_pipeline.messages.image import ImageError

if TYPE_CHECKING:
    from inspect_pipeline.arrays import ImageArray

_MAX_PIXELS = 160 << 20  # cameras have up to 150 megapixels
_MAX_PIXELS_PER_BYTE = 10_000  # a PNG of one bit and one colour has 8,256
_SMALL_PIXELS = 4 << 20
_MAX_LEAD_BYTES = 64  # before a JPEG
_JPEG, _PNG = b"\xff\xd8\xff", b"\x89PNG\r\n\x1a\n"
_JPEG_END = b"\xff\xd9"
# Of the formats that Pillow knows; others may run programs or are no images of cameras.
_FORMATS = ("PNG", "WEBP", "TIFF", "BMP", "GIF", "AVIF", "JPEG2000", "PPM", "QOI", "JPEG")
_COLOUR_MODES = ("RGB", "RGBA", "RGBX")
# Pillow's names of the upper byte of 16 bits, and of the lower: N is the order of this machine.
_FOREIGN = "B" if sys.byteorder == "little" else "L"
_OTHER_BYTES = {
    f"{mode};16{order}": f"{mode};16{other}"
    for mode in _COLOUR_MODES
    for order, other in (("B", "L"), ("L", "B"), ("N", _FOREIGN))
}
_GREY = conversion(cv2.COLOR_GRAY2RGB)

logging.getLogger("PIL").setLevel(logging.CRITICAL + 1)
warnings.filterwarnings("ignore", module="PIL")


def decode_compressed(data: memoryview) -> Pixels:
    """Decode an image file. Raises ImageError."""
    start = bytes(data[: _MAX_LEAD_BYTES + len(_JPEG)]).find(_JPEG)
    if start == 0 or (start > 0 and not _is_known(data)):
        return _decode_jpeg(data[start:])
    if data[:8] == _PNG:
        _check_png(data)
    return _decode_with_pillow(data)


def _is_known(data: memoryview) -> bool:
    """Whether Pillow knows what the first bytes are."""
    try:
        Image.open(BytesIO(data), formats=_FORMATS).close()
    except Exception:
        return False
    return True


def _decode_jpeg(data: memoryview) -> Pixels:
    """Decode a JPEG; one with damage that leaves it whole is doubtful."""
    try:
        height, width, _, _ = simplejpeg.decode_jpeg_header(data, strict=False)
        _check_size(height * width, len(data))
        return Pixels(simplejpeg.decode_jpeg(data, "RGB"))
    except ImageError:
        raise
    except Exception as error:  # simplejpeg raises KeyError too, of damaged heads
        problem = str(error)
    if "Premature end of JPEG file" in problem:
        return _decode_without_end(data)
    if "Corrupt JPEG data" in problem and "premature end" not in problem:
        return _decode_damaged(data, problem)
    if "premature end" in problem:
        raise ImageError("the image is cut off")
    return _decode_with_pillow(data)  # of colours that simplejpeg does not convert, such as CMYK


def _decode_damaged(data: memoryview, problem: str) -> Pixels:
    """Decode a JPEG that has a damaged part, as far as the decoder gets over it."""
    try:
        pixels = simplejpeg.decode_jpeg(data, "RGB", strict=False)
    except Exception as error:  # some damage ends decoding even then
        raise ImageError("the image cannot be decoded") from error
    return Pixels(pixels, doubt=f"the image is damaged: {problem}")


def _decode_without_end(data: memoryview) -> Pixels:
    """Decode a JPEG without its end marker, which some cameras leave out; a cut one is an error."""
    whole = bytes(data).rstrip(b"\0") + _JPEG_END
    try:
        return Pixels(simplejpeg.decode_jpeg(whole, "RGB"))
    except ValueError as error:
        raise ImageError("the image is cut off") from error


def _decode_with_pillow(data: memoryview) -> Pixels:
    try:
        with Image.open(BytesIO(data), formats=_FORMATS) as image:
            is_deep = _is_deep_colour(image)
            _check_size(image.width * image.height, len(data), _MAX_PIXELS // 2 if is_deep else _MAX_PIXELS)
            return _decode_deep_colour(data) if is_deep else _to_pixels(image)
    except ImageError:
        raise
    except Image.DecompressionBombError as error:
        raise ImageError(f"the image claims more than {_MAX_PIXELS >> 20} megapixels") from error
    except UnidentifiedImageError as error:
        raise ImageError("the image is not of a format that can be read") from error
    except Exception as error:  # its decoders raise whatever a damaged file causes, SyntaxError included
        raise ImageError("the image cannot be decoded") from error


def _is_deep_colour(image: Image.Image) -> bool:
    """Whether an image has colours of 16 bits, of which Pillow keeps the upper 8."""
    return (
        isinstance(image, ImageFile.ImageFile)
        and image.mode in _COLOUR_MODES
        and all(_raw_mode(tile) in _OTHER_BYTES for tile in image.tile)
    )


def _raw_mode(tile: Any) -> str:
    """Return how Pillow unpacks the bytes of a tile."""
    args = tile.args if isinstance(tile.args, tuple) else (tile.args,)
    return str(args[0]) if args else ""


def _decode_deep_colour(data: memoryview) -> Pixels:
    """Decode colours of 16 bits in two passes: Pillow gives one byte of each, the upper or the lower."""
    upper, lower = (_load_bytes(data, is_lower=is_lower) for is_lower in (False, True))
    values = (upper.astype(np.uint16) << 8) | lower
    return Pixels(values.astype(np.uint16, copy=False))


def _load_bytes(data: memoryview, *, is_lower: bool) -> ImageArray:
    with Image.open(BytesIO(data), formats=_FORMATS) as image:
        assert isinstance(image, ImageFile.ImageFile)  # noqa: S101 - it was found to be
        if is_lower:
            image.tile = [_of_other_bytes(tile) for tile in image.tile]
        return np.asarray(image, np.uint8)[..., :3]  # without opacity, which is of another range


def _of_other_bytes(tile: Any) -> Any:
    other = _OTHER_BYTES[_raw_mode(tile)]
    return tile._replace(args=(other, *tile.args[1:]) if isinstance(tile.args, tuple) else other)


def _to_pixels(image: Image.Image) -> Pixels:
    if image.mode == "F":
        raise ImageError("the image holds floating-point numbers")
    if image.mode.startswith("I"):  # of 16 bits, or of more when Pillow says so
        values = np.asarray(image)
        if values.min(initial=0) < 0 or values.max(initial=0) > 0xFFFF:
            raise ImageError("the image holds numbers of more than 16 bits")
        return Pixels(values.astype(np.uint16), _GREY)
    return Pixels(np.asarray(image.convert("RGB"), np.uint8))


def _check_size(n_pixels: int, n_bytes: int, n_most: int = _MAX_PIXELS) -> None:
    if n_pixels > n_most:
        raise ImageError(f"the image claims more than {n_most >> 20} megapixels")
    if n_pixels > max(_MAX_PIXELS_PER_BYTE * n_bytes, _SMALL_PIXELS):
        raise ImageError("the image claims more pixels than its bytes can hold")


def _check_png(data: memoryview) -> None:
    """Check the CRC of every chunk, which Pillow does not for those of pixels.

    What follows the last chunk is ignored: some recorders pad.
    """
    at, kind = 8, b""
    while at < len(data) and kind != b"IEND":
        end = at + 8 + int.from_bytes(data[at : at + 4])
        if end + 4 > len(data):
            raise ImageError("the image is cut off")
        if zlib.crc32(data[at + 4 : end]) != int.from_bytes(data[end : end + 4]):
            raise ImageError("the image does not match its CRC")
        at, kind = end + 4, bytes(data[at + 4 : at + 8])
