"""Damaged images: errors or doubts, without output of libraries and without their memory."""

from __future__ import annotations

import struct
import zlib
from io import BytesIO
from typing import Any

import cv2
import numpy as np
import pytest
from factories import encoded_picture, number_of, picture
from memory import grows_by_less_than
from PIL import Image

from inspect_pipeline.images.decode import ImageDecoder
from inspect_pipeline.messages.image import ImageError, ImageMessage


def decode(image: ImageMessage) -> np.ndarray:
    return ImageDecoder().decode(image).image


def message(data: bytes, image_format: str = "jpeg") -> ImageMessage:
    return ImageMessage(0, "", image_format, data)


def scene_jpeg(**options: Any) -> bytes:
    """A JPEG with enough detail that a changed byte of its data is likely to be noticed."""
    rng = np.random.default_rng(3)
    file = BytesIO()
    Image.fromarray(rng.integers(0, 255, (120, 160, 3), np.uint8)).save(file, "JPEG", quality=90, **options)
    return file.getvalue()


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".webp", ".bmp", ".tiff"])
@pytest.mark.parametrize(("size", "words"), [(0x3FF0, "megapixels"), (0x1FF0, "more pixels than its bytes")])
def test_an_image_that_claims_absurd_size_takes_no_memory(suffix: str, size: int, words: str) -> None:
    options = [cv2.IMWRITE_WEBP_QUALITY, 80] if suffix == ".webp" else []
    data = bytearray(cv2.imencode(suffix, picture(1), options)[1].tobytes())
    big, little = size.to_bytes(4, "big"), size.to_bytes(4, "little")
    at = {
        ".png": 16,
        ".jpg": data.find(b"\xff\xc0") + 5,
        ".webp": data.find(b"\x9d\x01\x2a") + 3,
        ".bmp": 18,
    }.get(suffix, 0)
    if suffix == ".tiff":
        for tag in (256, 257):  # width and height, one value each, of 16 bits or of 32
            entry = next(i for kind in (3, 4) if (i := data.find(struct.pack("<HHI", tag, kind, 1))) > 0)
            data[entry + 8 : entry + 12] = little
    else:
        claim = {".jpg": big[2:], ".webp": little[:2], ".bmp": little}.get(suffix, big) * 2
        data[at : at + len(claim)] = claim
    if suffix == ".png":
        data[29:33] = zlib.crc32(data[12:29]).to_bytes(4, "big")
    with grows_by_less_than(50), pytest.raises(ImageError, match=words):
        decode(message(bytes(data)))


def test_a_png_chunk_that_claims_absurd_size_takes_no_memory() -> None:
    data = bytearray(encoded_picture(1))
    at = data.index(b"IDAT") - 4
    data[at : at + 4] = b"\x7f\xff\xff\xf0"
    with pytest.raises(ImageError, match="cut off"):
        decode(message(bytes(data)))


def test_padding_after_a_png_is_ignored() -> None:
    assert number_of(decode(message(encoded_picture(7) + bytes(16), "png"))) == 7


def test_a_damaged_png_is_a_bad_frame_without_output(capfd: pytest.CaptureFixture[str]) -> None:
    """libpng, as OpenCV uses it, prints to stderr."""
    whole = encoded_picture(1)
    for at in range(8, len(whole)):
        damaged = bytearray(whole)
        damaged[at] ^= 0x40
        with pytest.raises(ImageError, match=r"CRC|cut off"):
            decode(message(bytes(damaged)))
    assert capfd.readouterr().err == ""


def test_a_damaged_tiff_is_a_bad_frame_without_output(caplog: pytest.LogCaptureFixture) -> None:
    """Pillow logs, and without a handler logging prints to stderr."""
    damaged = bytearray(encoded_picture(1, ".tiff"))
    at = damaged.index(struct.pack("<HHI", 277, 3, 1))  # samples per pixel
    damaged[at + 8] = 241
    with pytest.raises(ImageError):
        decode(message(bytes(damaged)))
    assert caplog.records == []


@pytest.mark.parametrize("change", ["no end", "zeros behind", "another behind", "zeros before"])
def test_a_jpeg_that_is_whole_but_untidy(change: str) -> None:
    data = scene_jpeg()
    changed = {
        "no end": data[:-2],
        "zeros behind": data + bytes(5000),
        "another behind": data + data,
        "zeros before": b"\0\0" + data,
    }[change]
    decoded = ImageDecoder().decode(message(changed))
    assert decoded.doubt is None
    np.testing.assert_array_equal(decoded.image, decode(message(data)))


@pytest.mark.parametrize("share", [0.3, 0.5, 0.9, 0.99])
@pytest.mark.parametrize("ending", [b"", b"\xff\xd9", bytes(1000)])
def test_a_cut_jpeg_is_an_image_error(share: float, ending: bytes) -> None:
    data = scene_jpeg()
    with pytest.raises(ImageError, match="cut off"):
        decode(message(data[: int(len(data) * share)] + ending))


def test_damaged_jpegs_are_doubtful_or_errors_without_output(capfd: pytest.CaptureFixture[str]) -> None:
    data, rng = scene_jpeg(), np.random.default_rng(1)
    outcomes = []
    for _ in range(20):
        damaged = bytearray(data)
        for at in rng.integers(len(data) // 3, len(data) - 10, 30):
            damaged[at] ^= 0x55
        try:
            outcomes.append(ImageDecoder().decode(message(bytes(damaged))).doubt)
        except ImageError as reason:
            outcomes.append(str(reason))
    assert all(outcomes)
    assert any("damaged: Corrupt JPEG data" in str(outcome) for outcome in outcomes)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("marker", [b"\xff\xc0", b"\xff\xc4", b"\xff\xda", b"\xff\xdb"])
def test_a_jpeg_with_a_damaged_marker_is_a_bad_frame(marker: bytes) -> None:
    """The decoder skips the segment, and then fails for want of it."""
    damaged = encoded_picture(5, ".jpg").replace(marker, b"\x7f" + marker[1:], 1)
    with pytest.raises(ImageError):
        decode(message(damaged))
