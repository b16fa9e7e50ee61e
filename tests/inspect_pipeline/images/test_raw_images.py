"""Raw images: every pixel encoding becomes RGB, or an image error."""

from __future__ import annotations

import factories
import numpy as np
import pytest
from factories import RAW_ENCODINGS, RawPixels, make_recording, number_of, picture

from inspect_pipeline.images.decode import ImageDecoder
from inspect_pipeline.messages.image import ImageError, ImageMessage, parse
from inspect_pipeline.recording.frames import iter_frames
from inspect_pipeline.recording.reader import open_recording


def decode(image: ImageMessage) -> np.ndarray:
    return ImageDecoder().decode(image).image


def raw(encoding: str, pixels: np.ndarray, *, padding: int = 0, is_big_endian: bool = False) -> RawPixels:
    """Rows of pixels as a raw image with so many bytes of padding a row."""
    dtype = pixels.dtype.newbyteorder(">" if is_big_endian else "<")
    rows = pixels.astype(dtype).reshape(len(pixels), -1).view(np.uint8)
    data = np.pad(rows, ((0, 0), (0, padding)), constant_values=77)
    height = len(pixels) * 2 // 3 if encoding == "nv12" else len(pixels)
    return RawPixels(encoding, height, pixels.shape[1], data.shape[1], data.tobytes(), is_big_endian)


def decode_raw(image: RawPixels) -> np.ndarray:
    payload = factories.ros2_cdr(0, "", image)
    return decode(parse("sensor_msgs/msg/Image", "cdr", memoryview(payload)))


@pytest.mark.parametrize("name", RAW_ENCODINGS)
def test_raw_recordings_are_read(name: str, tmp_path) -> None:
    shots = [shot._replace(data=raw("rgb8", picture(shot.number), padding=5)) for shot in factories.shots(4)]
    path = make_recording(tmp_path / "a.mcap", shots, encoding=RAW_ENCODINGS[name])
    frames = list(iter_frames(open_recording(path)))
    assert [(number_of(f.image), f.frame_id, f.stamp_ns - f.log_time_ns) for f in frames] == [
        (i, "cam", -factories.STAMP_LAG_NS) for i in range(4)
    ]


@pytest.mark.parametrize("padding", [0, 3])
@pytest.mark.parametrize("is_big_endian", [False, True])
def test_pixel_encodings_without_loss(padding: int, is_big_endian: bool) -> None:
    rgb = picture(77)
    alpha = np.full((*rgb.shape[:2], 1), 9, np.uint8)
    grey = rgb[..., 2]
    cases = {
        "rgb8": (rgb, rgb),
        "bgr8": (rgb[..., ::-1], rgb),
        "8UC3": (rgb[..., ::-1], rgb),
        "rgba8": (np.concatenate([rgb, alpha], -1), rgb),
        "bgra8": (np.concatenate([rgb[..., ::-1], alpha], -1), rgb),
        "8UC4": (np.concatenate([rgb[..., ::-1], alpha], -1), rgb),
        "mono8": (grey, np.dstack([grey] * 3)),
        "8UC1": (grey, np.dstack([grey] * 3)),
        "mono16": (grey.astype(np.uint16) * 256 + 200, np.dstack([grey] * 3)),
        "16UC1": (grey.astype(np.uint16) * 256 + 200, np.dstack([grey] * 3)),
    }
    for encoding, (pixels, expected) in cases.items():
        image = raw(encoding, pixels, padding=padding * pixels.itemsize, is_big_endian=is_big_endian)
        np.testing.assert_array_equal(decode_raw(image), expected, err_msg=encoding)


def test_spellings_of_pixel_encodings() -> None:
    rgb = picture(77)
    for encoding in ("BGR8", "bgr8 ", "8uc3"):
        np.testing.assert_array_equal(decode_raw(raw(encoding, rgb[..., ::-1])), rgb, err_msg=encoding)


@pytest.mark.parametrize("is_big_endian", [False, True])
def test_16_bit_colours(is_big_endian: bool) -> None:
    rgb = picture(77)
    deep, alpha = rgb.astype(np.uint16) * 257, np.full((*rgb.shape[:2], 1), 9, np.uint16)
    bgra = np.concatenate([deep[..., ::-1], alpha], -1)
    cases = {"rgb16": deep, "bgr16": deep[..., ::-1], "16UC3": deep[..., ::-1], "bgra16": bgra, "16UC4": bgra}
    for encoding, pixels in cases.items():
        image = raw(encoding, pixels, is_big_endian=is_big_endian)
        np.testing.assert_array_equal(decode_raw(image), rgb, err_msg=encoding)


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
@pytest.mark.parametrize("bits", [8, 16])
def test_bayer_patterns_of_one_colour(pattern: str, bits: int) -> None:
    colour = {"r": 200, "g": 120, "b": 40}
    block = np.array([colour[c] for c in pattern]).reshape(2, 2)
    pixels = np.tile(block, (8, 8))
    pixels = (pixels * 257).astype(np.uint16) if bits == 16 else pixels.astype(np.uint8)
    decoded = decode_raw(raw(f"bayer_{pattern}{bits}", pixels))
    assert np.abs(decoded[2:-2, 2:-2].astype(int) - [200, 120, 40]).max() <= 1


YUV_422 = {"yuv422": "uyvy", "uyvy": "uyvy", "yuv422_yuy2": "yuyv", "yuyv": "yuyv", "YUY2": "yuyv"}


YUV_420 = ("nv12", "nv21", "i420", "yuv420", "yv12")


HALVES = ((120, 90, 180), (150, 140, 110))  # y, u, v of the upper and the lower half


def rgb_of(y: int, u: int, v: int) -> list[float]:
    """BT.601 in limited range."""
    luma = 1.164 * (y - 16)
    return [luma + 1.596 * (v - 128), luma - 0.813 * (v - 128) - 0.391 * (u - 128), luma + 2.018 * (u - 128)]


def yuv_image(encoding: str, height: int, width: int, padding: int = 0) -> RawPixels:
    """An image whose upper and lower half have one colour each, packed by hand; height is a multiple of 4."""
    halves = [HALVES[0]] * (height // 2) + [HALVES[1]] * (height - height // 2)
    shared = [halves[row] for row in range(0, height, 2)]  # colours of the rows of 4:2:0 chroma
    n_pairs = (width + 1) // 2
    if encoding in YUV_422:
        order = [YUV_422[encoding][i] for i in range(4)]
        of = [dict(zip("yuv", row, strict=True)) for row in halves]
        rows = [bytes([one[c] for c in order] * n_pairs)[: 2 * width] for one in of]
    elif encoding == "nv24":
        rows = [bytes([y]) * width for y, _, _ in halves]
        pairs = [bytes([u, v] * width) for _, u, v in halves]
        rows += [half for row in pairs for half in (row[:width], row[width:])]
    elif encoding in {"nv12", "nv21"}:
        rows = [bytes([y]) * width for y, _, _ in halves]
        rows += [bytes([u, v] if encoding == "nv12" else [v, u]) * n_pairs for _, u, v in shared]
    else:
        planes = [[u for _, u, _ in shared], [v for _, _, v in shared]]
        planes = planes[::-1] if encoding == "yv12" else planes
        chroma = b"".join(bytes([value]) * n_pairs for plane in planes for value in plane)
        rows = [bytes([y]) * width for y, _, _ in halves]
        rows += [chroma[at : at + width] for at in range(0, len(chroma), width)]
    step = max(len(row) for row in rows) + padding
    return RawPixels(encoding, height, width, step, b"".join(row.ljust(step, b"M") for row in rows))


@pytest.mark.parametrize("padding", [0, 4])
@pytest.mark.parametrize("encoding", [*YUV_422, "nv12", "nv21", "nv24"])
def test_yuv(encoding: str, padding: int) -> None:
    check_halves(decode_raw(yuv_image(encoding, 8, 16, padding)))


@pytest.mark.parametrize("encoding", YUV_420)
def test_yuv_without_padding(encoding: str) -> None:
    check_halves(decode_raw(yuv_image(encoding, 8, 16)))


@pytest.mark.parametrize(("encoding", "size"), [("yuyv", (8, 15)), ("nv24", (8, 15))])
def test_yuv_of_odd_width(encoding: str, size: tuple[int, int]) -> None:
    image = decode_raw(yuv_image(encoding, *size))
    assert image.shape == (*size, 3)
    check_halves(image)


@pytest.mark.parametrize("size", [(7, 16), (8, 15), (7, 15)])
def test_nv12_of_odd_size(size: tuple[int, int]) -> None:
    even = yuv_image("nv12", 8, 16)
    rows = [even.data[i : i + 16] for i in range(0, len(even.data), 16)]
    luma, chroma = rows[: size[0]], rows[8:]
    image = decode_raw(even._replace(height=size[0], width=size[1], data=b"".join(luma + chroma)))
    np.testing.assert_array_equal(image, decode_raw(even)[: size[0], : size[1]])


def check_halves(image: np.ndarray) -> None:
    half = len(image) // 2
    assert np.abs(image[:half].astype(float) - rgb_of(*HALVES[0])).max() <= 3
    assert np.abs(image[half:].astype(float) - rgb_of(*HALVES[1])).max() <= 3


def test_a_raw_image_smaller_than_it_says_is_an_image_error() -> None:
    image = raw("rgb8", picture(1))
    for wrong in (
        image._replace(height=1000),
        image._replace(step_bytes=3, data=image.data + b"?"),
        image._replace(width=0),
        image._replace(data=image.data[:-1]),
        image._replace(height=2**32 - 1, width=2**32 - 1),
    ):
        with pytest.raises(ImageError):
            decode_raw(wrong)
    np.testing.assert_array_equal(decode_raw(image._replace(step_bytes=0)), picture(1))
