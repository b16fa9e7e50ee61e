from __future__ import annotations

import base64
import json

import factories
import numpy as np
import pytest
import zstandard
from factories import ENCODINGS, RAW_ENCODINGS, RawPixels, encoded_picture
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from inspect_pipeline.messages.image import ImageError, codec_named, is_image, looks_like_image, parse

STAMP_NS = 1_700_000_000_123_456_789


@pytest.mark.parametrize("name", ENCODINGS)
@pytest.mark.parametrize("frame_id", ["", "a", "camera_left", "längs"])
def test_messages_are_parsed(name: str, frame_id: str) -> None:
    how = ENCODINGS[name]
    data = encoded_picture(7)
    parsed = parse(how.schema_name, how.message_encoding, memoryview(how.encode(STAMP_NS, frame_id, data)))
    assert (parsed.stamp_ns, parsed.frame_id, bytes(parsed.data)) == (STAMP_NS, frame_id, data)
    assert is_image(how.schema_name, how.message_encoding)


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


def test_a_json_frame_id_with_a_lone_surrogate_can_be_written() -> None:
    payload = json.dumps({"frame_id": "a\ud800", "data": "", "format": "png"}).encode()
    assert parse("foxglove.CompressedImage", "json", memoryview(payload)).frame_id == "a?"


@pytest.mark.parametrize(
    ("spelling", "how"),
    [
        ("sensor_msgs/CompressedImage", "ros2"),
        ("sensor_msgs::CompressedImage", "ros2"),
        ("sensor_msgs::msg::CompressedImage", "ros2"),
        ("sensor_msgs::msg::dds_::CompressedImage_", "ros2"),
        ("sensor_msgs.msg.CompressedImage", "ros2"),
        ("foxglove.CompressedImage", "foxglove ros2"),
        ("foxglove::CompressedImage", "foxglove ros2"),
        ("foxglove_msgs/CompressedImage", "foxglove ros2"),
        ("foxglove.CompressedVideo", "foxglove ros2"),
        ("foxglove_msgs::msg::CompressedVideo", "foxglove ros2"),
        ("sensor_msgs/msg/CompressedImage", "ros1"),
    ],
)
def test_spellings_of_a_schema(spelling: str, how: str) -> None:
    payload = ENCODINGS[how].encode(STAMP_NS, "cam", encoded_picture(7))
    parsed = parse(spelling, ENCODINGS[how].message_encoding, memoryview(payload))
    assert (parsed.stamp_ns, parsed.frame_id, bytes(parsed.data)) == (STAMP_NS, "cam", encoded_picture(7))
    assert not parsed.is_video


@pytest.mark.parametrize(
    "schema", ["CompressedImage", "acme/CompressedImage", "sensor_msgs/msg/CameraInfo", ""]
)
def test_other_types_are_not_images(schema: str) -> None:
    assert not is_image(schema, "cdr")


def test_unread_types_that_look_like_images() -> None:
    assert looks_like_image("theora_image_transport/msg/Packet")
    assert looks_like_image("acme.StereoImage")
    assert not looks_like_image("sensor_msgs/msg/CameraInfo")


DATA = bytes(range(256)) * 3  # its base64 has both signs that the URL-safe alphabet replaces
PLAIN = base64.b64encode(DATA).decode()


@pytest.mark.parametrize(
    ("text", "data"),
    [
        (PLAIN, DATA),
        (base64.encodebytes(DATA).decode(), DATA),
        (PLAIN.replace("/", "/\r\n"), DATA),
        (base64.urlsafe_b64encode(DATA).decode(), DATA),
        (base64.urlsafe_b64encode(DATA[:-1]).decode().rstrip("="), DATA[:-1]),
        (base64.b64encode(DATA[:-2]).decode().rstrip("="), DATA[:-2]),
        (f"data:image/jpeg;base64,{PLAIN}", DATA),
        (f"data:image/jpeg;base64,{base64.encodebytes(DATA).decode()}", DATA),
    ],
)
def test_forms_of_base64(text: str, data: bytes) -> None:
    payload = json.dumps({"data": text, "format": "jpeg"}).encode()
    assert parse("foxglove.CompressedImage", "json", memoryview(payload)).data == data


@pytest.mark.parametrize("text", ["A", "AAAA\u00e9", "####", 7, None, ["a"]])
def test_what_is_not_base64_is_an_image_error(text: object) -> None:
    payload = json.dumps({"data": text, "format": "jpeg"}).encode()
    with pytest.raises(ImageError, match=r"not a foxglove\.CompressedImage"):
        parse("foxglove.CompressedImage", "json", memoryview(payload))


def test_an_ffmpeg_packet_is_video() -> None:
    kind = "ffmpeg_image_transport_msgs/msg/FFMPEGPacket"
    fields = "int32 width\nint32 height\nstring encoding\nuint64 pts\nuint8 flags\nbool is_bigendian\n"
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg("std_msgs/Header header\n" + fields + "uint8[] data\n", kind))
    stamp = store.types["builtin_interfaces/msg/Time"](STAMP_NS // 10**9, STAMP_NS % 10**9)
    header = store.types["std_msgs/msg/Header"](stamp, "cam")
    data = b"\0\0\0\1\x67video"
    packet = store.types[kind](header, 320, 240, "libx265", 7, 1, False, np.frombuffer(data, np.uint8))

    parsed = parse(kind, "cdr", memoryview(bytes(store.serialize_cdr(packet, kind))))
    assert (parsed.stamp_ns, parsed.frame_id, parsed.encoding) == (STAMP_NS, "cam", "libx265")
    assert bytes(parsed.data) == data
    assert parsed.is_video


@pytest.mark.parametrize(
    ("name", "codec"),
    [
        ("h264", "h264"),
        ("H.264", "h264"),
        ("avc1", "h264"),
        ("libx264", "h264"),
        ("h264_vaapi;nv12;bgr8", "h264"),
        ("video/H265", "hevc"),
        ("hev1", "hevc"),
        ("hvc1", "hevc"),
        ("x265", "hevc"),
        ("hevc_nvenc", "hevc"),
        ("VP8", "vp8"),
        ("vp09.00.10.08", "vp9"),
        ("av01", "av1"),
        ("jpeg", None),
        ("rgb8; jpeg compressed bgr8", None),
        ("mpeg4", None),
        ("", None),
    ],
)
def test_names_of_codecs(name: str, codec: str | None) -> None:
    assert codec_named(name) == codec


def test_a_message_that_the_recorder_compressed_is_an_image_error() -> None:
    payload = zstandard.compress(factories.ros2_cdr(STAMP_NS, "cam", encoded_picture(7)))
    with pytest.raises(ImageError, match="compressed with zstd"):
        parse("sensor_msgs/msg/CompressedImage", "cdr", memoryview(payload))


@pytest.mark.parametrize("name", RAW_ENCODINGS)
def test_raw_images_are_parsed(name: str) -> None:
    how, image = RAW_ENCODINGS[name], RawPixels("mono8", 2, 3, 4, bytes(8))
    parsed = parse(how.schema_name, how.message_encoding, memoryview(how.encode(STAMP_NS, "cam", image)))
    assert parsed.raw is not None
    assert (parsed.raw.height, parsed.raw.width, parsed.raw.step_bytes, parsed.encoding) == (2, 3, 4, "mono8")
    assert bytes(parsed.data) == bytes(8)
