from __future__ import annotations

import json
import resource
import struct
import zlib
from io import BytesIO
from typing import Any

import cv2
import factories
import numpy as np
import pytest
from factories import ENCODINGS, RAW_ENCODINGS, RawPixels, encoded_picture, make_recording, number_of, picture
from PIL import Image

from inspect_pipeline.images.decode import ImageError, ImageMessage, decode, is_image, parse, refusal
from inspect_pipeline.recording.frames import iter_frames
from inspect_pipeline.recording.reader import open_recording

STAMP_NS = 1_700_000_000_123_456_789


def message(data: bytes, image_format: str = "jpeg") -> ImageMessage:
    return ImageMessage(0, "", image_format, data)


@pytest.mark.parametrize("name", ENCODINGS)
@pytest.mark.parametrize("frame_id", ["", "a", "camera_left", "längs"])
def test_messages_are_taken_apart(name: str, frame_id: str) -> None:
    how = ENCODINGS[name]
    data = encoded_picture(7)
    parsed = parse(how.schema_name, how.message_encoding, memoryview(how.encode(STAMP_NS, frame_id, data)))
    assert (parsed.stamp_ns, parsed.frame_id, bytes(parsed.data)) == (STAMP_NS, frame_id, data)
    assert is_image(how.schema_name, how.message_encoding)


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


def test_big_endian_cdr() -> None:
    payload = factories.ros2_cdr(STAMP_NS, "cam", encoded_picture(7), little_endian=False)
    parsed = parse("sensor_msgs/msg/CompressedImage", "cdr", memoryview(payload))
    assert (parsed.stamp_ns, parsed.frame_id, bytes(parsed.data)) == (STAMP_NS, "cam", encoded_picture(7))


@pytest.mark.parametrize(
    ("timestamp", "stamp_ns"),
    [
        ({"sec": 12, "nsec": 34}, 12_000_000_034),
        ("2023-11-14T22:13:20.123456789Z", STAMP_NS),
        ("2023-11-15T00:13:20.123456789+02:00", STAMP_NS),
        ("2023-11-14T22:13:20Z", 1_700_000_000_000_000_000),
    ],
)
def test_json_timestamps(timestamp: object, stamp_ns: int) -> None:
    fields = {"timestamp": timestamp, "data": ""}
    parsed = parse("foxglove.CompressedImage", "json", memoryview(json.dumps(fields).encode()))
    assert parsed.stamp_ns == stamp_ns


@pytest.mark.parametrize("suffix", [".png", ".webp", ".bmp", ".tiff"])
def test_the_first_bytes_tell_the_codec_and_colours_are_rgb(suffix: str) -> None:
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


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
@pytest.mark.parametrize("bits", [8, 16])
def test_bayer_patterns_of_one_colour(pattern: str, bits: int) -> None:
    colour = {"r": 200, "g": 120, "b": 40}
    block = np.array([colour[c] for c in pattern]).reshape(2, 2)
    pixels = np.tile(block, (8, 8))
    pixels = (pixels * 257).astype(np.uint16) if bits == 16 else pixels.astype(np.uint8)
    decoded = decode_raw(raw(f"bayer_{pattern}{bits}", pixels))
    assert np.abs(decoded[2:-2, 2:-2].astype(int) - [200, 120, 40]).max() <= 1


@pytest.mark.parametrize("encoding", ["yuv422", "uyvy", "yuv422_yuy2", "yuyv", "nv12"])
def test_yuv_of_one_colour(encoding: str) -> None:
    y, u, v = 120, 90, 180  # by BT.601, limited range:
    luma = 1.164 * (y - 16)
    rgb = [luma + 1.596 * (v - 128), luma - 0.813 * (v - 128) - 0.391 * (u - 128), luma + 2.018 * (u - 128)]
    if encoding == "nv12":
        chroma = np.tile(np.array([u, v], np.uint8), (4, 8))
        pixels = np.concatenate([np.full((8, 16), y, np.uint8), chroma])
    else:
        pair = [u, y, v, y] if encoding in {"yuv422", "uyvy"} else [y, u, y, v]
        pixels = np.tile(np.array(pair, np.uint8), (8, 8)).reshape(8, 16, 2)
    decoded = decode_raw(raw(encoding, pixels, padding=4))
    assert decoded.shape == (8, 16, 3)
    assert np.abs(decoded.astype(float) - rgb).max() <= 3


def test_a_raw_image_smaller_than_it_says_is_an_image_error() -> None:
    image = raw("rgb8", picture(1))
    for wrong in (
        image._replace(height=1000),
        image._replace(step_bytes=3),
        image._replace(width=0),
        image._replace(data=image.data[:-1]),
        image._replace(height=2**32 - 1, width=2**32 - 1),
    ):
        with pytest.raises(ImageError):
            decode_raw(wrong)
    np.testing.assert_array_equal(decode_raw(image._replace(step_bytes=0)), picture(1))


def test_what_is_not_processed_and_why() -> None:
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
    memory_before_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(ImageError, match=words):
        decode(message(bytes(data)))
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - memory_before_kb < 50 << 10


def test_a_png_chunk_that_claims_absurd_size_takes_no_memory() -> None:
    data = bytearray(encoded_picture(1))
    at = data.index(b"IDAT") - 4
    data[at : at + 4] = b"\x7f\xff\xff\xf0"
    with pytest.raises(ImageError, match="cut off"):
        decode(message(bytes(data)))


def test_padding_behind_a_png_is_no_damage() -> None:
    assert number_of(decode(message(encoded_picture(7) + bytes(16), "png"))) == 7


def test_a_frame_id_of_json_that_is_no_text_can_be_written() -> None:
    payload = json.dumps({"frame_id": "a\ud800", "data": "", "format": "png"}).encode()
    assert parse("foxglove.CompressedImage", "json", memoryview(payload)).frame_id == "a?"


def test_a_damaged_png_is_found_quietly(capfd: pytest.CaptureFixture[str]) -> None:
    """libpng would tell stderr."""
    whole = encoded_picture(1)
    for at in range(8, len(whole)):
        damaged = bytearray(whole)
        damaged[at] ^= 0x40
        with pytest.raises(ImageError, match=r"CRC|cut off"):
            decode(message(bytes(damaged)))
    assert capfd.readouterr().err == ""


def test_a_damaged_tiff_is_found_quietly(caplog: pytest.LogCaptureFixture) -> None:
    """Pillow would tell its logger, which without another reader tells stderr."""
    damaged = bytearray(encoded_picture(1, ".tiff"))
    at = damaged.index(struct.pack("<HHI", 277, 3, 1))  # samples per pixel
    damaged[at + 8] = 241
    with pytest.raises(ImageError):
        decode(message(bytes(damaged)))
    assert caplog.records == []


def test_video_is_known_by_its_first_bytes_and_is_no_image() -> None:
    payload = factories.ros2_cdr(0, "", b"\0\0\0\1\x67" + b"x" * 50)
    parsed = parse("sensor_msgs/msg/CompressedImage", "cdr", memoryview(payload))
    assert parsed.is_video
    with pytest.raises(ImageError, match="video"):
        decode(parsed)
