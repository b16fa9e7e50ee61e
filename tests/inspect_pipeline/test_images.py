from __future__ import annotations

import json

import cv2
import factories
import numpy as np
import pytest
from factories import ENCODINGS, encoded_picture, picture

from inspect_pipeline.images import ImageError, ImageMessage, decode, is_image, parse

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
        assert name == "protobuf"  # whose fields may be absent or come in any order
        assert length >= len(encoded_picture(7))


def test_big_endian_cdr() -> None:
    how = factories.ROS2
    ros_message = factories.ros2_compressed_image(STAMP_NS, "cam", encoded_picture(7))
    payload = bytes(how.serialize_cdr(ros_message, "sensor_msgs/msg/CompressedImage", little_endian=False))
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
