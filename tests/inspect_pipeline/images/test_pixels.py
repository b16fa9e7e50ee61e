"""The range of 16-bit values that is shown."""

from __future__ import annotations

import struct
import zlib
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest
from factories import RAW_ENCODINGS, START_NS, STEP_NS, RawPixels, make_recording, picture, shots

from inspect_pipeline.images.decode import ImageDecoder
from inspect_pipeline.images.pixels import FULL_RANGE, ValueRange, range_in_use
from inspect_pipeline.messages.image import ImageError, ImageMessage, RawLayout
from inspect_pipeline.recording.frames import iter_frames
from inspect_pipeline.recording.reader import open_recording

if TYPE_CHECKING:
    from pathlib import Path

GREY = np.add.outer(np.arange(60), 3 * np.arange(60)).astype(np.uint16) % 256  # all values of 8 bits


def mono16(values: np.ndarray) -> ImageMessage:
    height, width = values.shape
    data = values.astype("<u2").tobytes()
    return ImageMessage(0, "", "mono16", data, RawLayout(height, width, 2 * width))


@pytest.mark.parametrize("bits", [8, 10, 12, 14, 16])
def test_the_least_bits_that_hold_the_values_are_shown(bits: int) -> None:
    deep = GREY << (bits - 8)
    assert range_in_use([deep]) == ValueRange(0, (1 << bits) - 1)
    np.testing.assert_array_equal(ImageDecoder().decode(mono16(deep)).image[..., 0], GREY)


@pytest.mark.parametrize("bits", [10, 12])
def test_deep_pngs_are_scaled_alike(bits: int) -> None:
    data = cv2.imencode(".png", GREY << (bits - 8))[1].tobytes()
    image = ImageDecoder().decode(ImageMessage(0, "", "mono16; png compressed ", data)).image
    np.testing.assert_array_equal(image, np.dstack([GREY] * 3))


@pytest.mark.parametrize("suffix", [".png", ".tiff"])
@pytest.mark.parametrize("channels", [3, 4])
def test_deep_colours_are_scaled_alike(suffix: str, channels: int, capfd: pytest.CaptureFixture[str]) -> None:
    """12 bits of 16, red, green and blue apart, with and without opacity."""
    rgb = np.dstack([GREY, GREY[::-1], GREY[:, ::-1]])
    deep = np.dstack([rgb[..., ::-1] << 4, *[np.full_like(GREY, 0xFFFF)] * (channels - 3)])
    data = cv2.imencode(suffix, deep)[1].tobytes()
    if suffix == ".png":  # a colour profile that libpng would print of
        profile = b"iCCPx\0\0" + zlib.compress(bytes(200))
        chunk = struct.pack(">I", len(profile) - 4) + profile + struct.pack(">I", zlib.crc32(profile))
        data = data[:33] + chunk + data[33:]
    image = ImageDecoder().decode(ImageMessage(0, "", suffix[1:], data)).image
    np.testing.assert_array_equal(image, rgb)
    assert capfd.readouterr().err == ""


def test_a_deep_png_without_its_last_chunk() -> None:
    """Pillow reads it, and so it is read, or is a bad frame."""
    whole = cv2.imencode(".png", np.dstack([GREY << 4] * 3))[1].tobytes()
    try:
        image = ImageDecoder().decode(ImageMessage(0, "", "png", whole[:-12])).image
    except ImageError:
        return
    np.testing.assert_array_equal(image, np.dstack([GREY] * 3))


def test_a_narrow_band_far_above_zero_is_spread() -> None:
    """As of a thermal camera of 14 bits: 255 values of 16,384."""
    image = ImageDecoder().decode(mono16(7000 + GREY)).image[..., 0].astype(int)
    assert image.max() - image.min() > 40
    assert 80 < image.mean() < 176
    order = np.argsort(GREY, axis=None, kind="stable")
    assert (np.diff(image.ravel()[order]) >= 0).all()


def test_the_first_images_decide_for_all() -> None:
    bright, dark = GREY << 4, GREY
    decoder = ImageDecoder(lambda: [mono16(dark), mono16(bright)])
    np.testing.assert_array_equal(decoder.decode(mono16(bright)).image[..., 0], GREY)
    np.testing.assert_array_equal(decoder.decode(mono16(dark)).image[..., 0], GREY >> 4)
    assert decoder.decode(mono16(GREY << 8)).image.max() == 255  # clipped, not wrapped


def test_black_images_and_dead_pixels_decide_nothing() -> None:
    black, hot = np.zeros((60, 60), np.uint16), GREY << 2
    hot[0, 0] = 0xFFFF
    assert range_in_use([black, hot]) == ValueRange(0, 1023)
    assert range_in_use([black]) == range_in_use([]) == FULL_RANGE


@pytest.mark.parametrize("options", [{}, {"every": 3}, {"start_ns": START_NS + 4 * STEP_NS}])
def test_a_frame_looks_the_same_however_it_is_reached(tmp_path: Path, options: dict[str, int]) -> None:
    """The first images of the recording decide, not the first that are decoded."""
    levels = [4, 4, 1, 1, 1, 1, 1]
    images = [picture(i)[..., 2].astype(np.uint16) << level for i, level in enumerate(levels)]
    raw = [RawPixels("mono16", 12, 16, 32, image.astype("<u2").tobytes()) for image in images]
    to_write = [shot._replace(data=data) for shot, data in zip(shots(len(raw)), raw, strict=True)]
    path = make_recording(tmp_path / "a.mcap", to_write, encoding=RAW_ENCODINGS["ros2"])
    for frame in iter_frames(open_recording(path), **options):
        expected = images[frame.frame_idx] >> 4
        assert frame.image is not None
        np.testing.assert_array_equal(frame.image[..., 0], expected)
