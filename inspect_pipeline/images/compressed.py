"""Compressed images to pixels: JPEG by libjpeg-turbo, all other formats by Pillow.

The first bytes decide what an image is. Its size is read, and bounded, before memory is taken for it. Both
libraries report what is wrong as exceptions; OpenCV would leave warnings of libjpeg and libpng to stderr, and
gets only colours of 16 bits, after Pillow has found them whole.
"""

from __future__ import annotations

import logging
import warnings
import zlib
from io import BytesIO

import cv2
import numpy as np
import simplejpeg
from PIL import Image, UnidentifiedImageError
from PIL.TiffImagePlugin import TiffImageFile

from inspect_pipeline.images.pixels import Pixels, conversion
from inspect_pipeline.messages.image import ImageError

_MAX_PIXELS = 160 << 20  # cameras have up to 150 megapixels
_MAX_PIXELS_PER_BYTE = 10_000  # a PNG of one bit and one colour has 8,256
_SMALL_PIXELS = 4 << 20
_MAX_LEAD_BYTES = 64  # before a JPEG
_JPEG, _PNG = b"\xff\xd8\xff", b"\x89PNG\r\n\x1a\n"
_JPEG_END = b"\xff\xd9"
# Of the formats that Pillow knows; others may run programs or are no images of cameras.
_FORMATS = ("PNG", "WEBP", "TIFF", "BMP", "GIF", "AVIF", "JPEG2000", "PPM", "QOI", "JPEG")
_GREY = conversion(cv2.COLOR_GRAY2RGB)
_TIFF_BITS = 258  # the tag of bits per sample
_FROM_BGR = conversion(cv2.COLOR_BGR2RGB)

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
            _check_size(image.width * image.height, len(data))
            if _is_deep_colour(image, data):
                image.load()  # raises for damage, of which OpenCV would print
                return _decode_deep_colour(data)
            return _to_pixels(image)
    except ImageError:
        raise
    except Image.DecompressionBombError as error:
        raise ImageError(f"the image claims more than {_MAX_PIXELS >> 20} megapixels") from error
    except UnidentifiedImageError as error:
        raise ImageError("the image is not of a format that can be read") from error
    except Exception as error:  # its decoders raise whatever a damaged file causes, SyntaxError included
        raise ImageError("the image cannot be decoded") from error


def _is_deep_colour(image: Image.Image, data: memoryview) -> bool:
    """Whether an image has colours of 16 bits, of which Pillow keeps the upper 8."""
    if image.format == "PNG":
        bits, colours = data[24:26]
        return bits == 16 and colours != 0  # 0: grey
    return (
        isinstance(image, TiffImageFile)
        and image.mode.startswith("RGB")
        and 16 in image.tag_v2.get(_TIFF_BITS, ())
    )


def _decode_deep_colour(data: memoryview) -> Pixels:
    pixels = data if data[:8] != _PNG else _without_notes(data)
    values = cv2.imdecode(np.frombuffer(pixels, np.uint8), cv2.IMREAD_UNCHANGED)
    if values is None or values.dtype != np.uint16 or values.ndim != 3:
        raise ImageError("the image cannot be decoded")
    return Pixels(
        np.asarray(values[..., :3], np.uint16), _FROM_BGR
    )  # opacity is not in the range of a sensor


def _without_notes(data: memoryview) -> bytes:
    """Return a PNG without the chunks beside its pixels, such as a colour profile that libpng prints of."""
    kept, at, kind = bytearray(_PNG), len(_PNG), b""
    while kind != b"IEND":
        end = at + 12 + int.from_bytes(data[at : at + 4])
        kind = bytes(data[at + 4 : at + 8])
        if kind in {b"IHDR", b"IDAT", b"IEND"}:
            kept += data[at:end]
        at = end
    return bytes(kept)


def _to_pixels(image: Image.Image) -> Pixels:
    if image.mode == "F":
        raise ImageError("the image holds floating-point numbers")
    if image.mode.startswith("I"):  # of 16 bits, or of more when Pillow says so
        values = np.asarray(image)
        if values.min(initial=0) < 0 or values.max(initial=0) > 0xFFFF:
            raise ImageError("the image holds numbers of more than 16 bits")
        return Pixels(values.astype(np.uint16), _GREY)
    return Pixels(np.asarray(image.convert("RGB"), np.uint8))


def _check_size(n_pixels: int, n_bytes: int) -> None:
    if n_pixels > _MAX_PIXELS:
        raise ImageError(f"the image claims more than {_MAX_PIXELS >> 20} megapixels")
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
