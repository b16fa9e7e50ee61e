"""Images of every format become RGB, or an image error that says why not."""

from __future__ import annotations

from contextlib import suppress
from io import BytesIO
from typing import Any

import cv2
import factories
import numpy as np
import pytest
from factories import ENCODINGS, RawPixels, encoded_picture, picture
from PIL import Image

from inspect_pipeline.images.decode import ImageDecoder, refusal
from inspect_pipeline.messages.image import ImageError, ImageMessage, parse

STAMP_NS = 1_700_000_000_123_456_789


def decode(image: ImageMessage) -> np.ndarray:
    return ImageDecoder().decode(image).image


def message(data: bytes, image_format: str = "jpeg") -> ImageMessage:
    return ImageMessage(0, "", image_format, data)


@pytest.mark.parametrize("name", ENCODINGS)
def test_every_truncation_of_a_message_is_an_image_error(name: str) -> None:
    how = ENCODINGS[name]
    payload = how.encode(STAMP_NS, "cam", encoded_picture(7))
    for length in range(len(payload)):
        try:
            parsed = parse(how.schema_name, how.message_encoding, memoryview(payload)[:length])
            decode(parsed)
        except ImageError:
            continue
        assert name in {"protobuf", "flatbuffer"}  # whose fields may be absent or come in any order
        assert length >= len(encoded_picture(7))


@pytest.mark.parametrize("suffix", [".png", ".webp", ".bmp", ".tiff"])
def test_the_first_bytes_decide_the_format_and_colours_are_rgb(suffix: str) -> None:
    options = [cv2.IMWRITE_WEBP_QUALITY, 101] if suffix == ".webp" else []
    data = cv2.imencode(suffix, cv2.cvtColor(picture(9), cv2.COLOR_RGB2BGR), options)[1].tobytes()
    np.testing.assert_array_equal(decode(message(data, "nonsense")), picture(9))


@pytest.mark.parametrize(
    ("mode", "options"), [("RGB", {}), ("RGB", {"subsampling": 0, "progressive": True}), ("L", {})]
)
def test_jpegs_are_what_pillow_decodes(mode: str, options: dict[str, Any]) -> None:
    x, y = np.meshgrid(np.linspace(0, 1, 96), np.linspace(0, 1, 64))
    scene = np.stack([255 * x, 255 * y, 128 + 100 * np.sin(9 * (x + y))], -1).astype(np.uint8)
    file = BytesIO()
    Image.fromarray(scene).convert(mode).save(file, "JPEG", quality=85, **options)
    expected = np.asarray(Image.open(BytesIO(file.getvalue())).convert("RGB"), np.int16)
    assert np.abs(decode(message(file.getvalue())) - expected).max() <= 3


def test_grey_and_16_bit_images_become_rgb() -> None:
    grey = picture(9)[..., 2]
    data = cv2.imencode(".png", grey.astype(np.uint16) * 257)[1].tobytes()
    np.testing.assert_array_equal(decode(message(data)), np.repeat(grey[..., np.newaxis], 3, 2))


def test_exif_orientation_is_ignored() -> None:
    jpeg = cv2.imencode(".jpg", np.zeros((12, 16, 3), np.uint8))[1].tobytes()
    rotate_90 = b"Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0"
    segment = b"\xff\xe1" + (len(rotate_90) + 2).to_bytes(2, "big") + rotate_90
    assert decode(message(jpeg[:2] + segment + jpeg[2:])).shape == (12, 16, 3)


@pytest.mark.parametrize("data", [b"", b"\0", b"\xff\xd8\xff", b"no image", encoded_picture(1)[:40]])
def test_what_cannot_be_decoded_is_an_image_error(data: bytes) -> None:
    with pytest.raises(ImageError, match="the image"):
        decode(message(data))


def test_reasons_to_refuse_a_topic() -> None:
    def ros_image(encoding: str) -> ImageMessage:
        payload = factories.ros2_cdr(0, "", RawPixels(encoding, 1, 1, 4, b"1234"))
        return parse("sensor_msgs/msg/Image", "cdr", memoryview(payload))

    assert refusal(ros_image("16UC1"), "/thermal/image_raw") is None
    assert refusal(ros_image("bgr8"), "/camera/depth/color") is None
    assert refusal(ros_image("16UC1"), "/camera/depth/image_rect") == "it holds distances"
    assert refusal(ros_image("32FC1"), "/camera/image") == "it holds distances"
    assert refusal(ros_image("invented"), "/camera/image") == "its pixel encoding 'invented' is not known"
    assert refusal(message(b"", "16UC1; compressedDepth png"), "/camera/image") == "it holds distances"
    assert refusal(message(encoded_picture(1)), "/camera/image") is None
    with pytest.raises(ImageError, match="'invented' is not known"):
        decode(ros_image("invented"))


def test_video_is_known_by_its_first_bytes_and_is_no_image() -> None:
    payload = factories.ros2_cdr(0, "", b"\0\0\0\1\x67" + b"x" * 50)
    parsed = parse("sensor_msgs/msg/CompressedImage", "cdr", memoryview(payload))
    assert parsed.is_video
    with pytest.raises(ImageError, match="video"):
        decode(parsed)


def test_a_jpeg_of_other_colours() -> None:
    """CMYK, as Pillow itself converts it."""
    file = BytesIO()
    Image.fromarray(picture(5)).convert("CMYK").save(file, "JPEG", quality=95)
    expected = np.asarray(Image.open(BytesIO(file.getvalue())).convert("RGB"))
    np.testing.assert_allclose(decode(message(file.getvalue())), expected, atol=1)


def unusual_files() -> dict[str, bytes]:
    """Files of formats and depths that no camera should send."""
    grey, rgb = picture(3)[..., 0], picture(3)
    files = {
        "grey pfm": b"Pf\n4 4\n-1.0\n" + bytes(64),
        "colour pfm": b"PF\n4 4\n-1.0\n" + bytes(192),
        "pgm of 16 bits": b"P5 2 2 65535\n" + bytes(8),
        "pam": b"P7\nWIDTH 14000\nHEIGHT 14000\nDEPTH 3\nMAXVAL 255\nTUPLTYPE RGB\nENDHDR\n" + bytes(100),
        "postscript": b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 10 10\nshowpage\n",
        "jxl": b"\xff\x0a" + bytes(40),
        "float tiff": cv2.imencode(".tiff", grey.astype(np.float32))[1].tobytes(),
        "double tiff": cv2.imencode(".tiff", grey.astype(np.float64))[1].tobytes(),
        "tiff of 16-bit colours": cv2.imencode(".tiff", rgb.astype(np.uint16))[1].tobytes(),
        "hdr": cv2.imencode(".hdr", rgb.astype(np.float32))[1].tobytes(),
        "png of 16-bit colours": cv2.imencode(".png", rgb.astype(np.uint16) * 257)[1].tobytes(),
    }
    for mode in ("1", "L", "LA", "P", "RGBA", "I"):
        file = BytesIO()
        Image.fromarray(rgb).convert(mode).save(file, "TIFF")
        files[f"{mode} tiff"] = file.getvalue()
    return files


@pytest.mark.parametrize(("name", "data"), unusual_files().items())
def test_every_format_gives_rgb_or_an_image_error(
    name: str, data: bytes, capfd: pytest.CaptureFixture[str]
) -> None:
    with suppress(ImageError):
        image = decode(message(data))
        assert (image.dtype, image.ndim, image.shape[2]) == (np.uint8, 3, 3)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("depth", ["16UC1; png compressed ", "16UC1; jpeg compressed ", "32FC1; png"])
def test_compressed_depth_is_no_camera(depth: str) -> None:
    assert refusal(message(encoded_picture(1), depth), "/depth/image/compressed") == "it holds distances"


def test_pictures_on_a_depth_topic_are_a_camera() -> None:
    assert refusal(message(encoded_picture(1), "bgr8; png compressed "), "/depth/image/compressed") is None
