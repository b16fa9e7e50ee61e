"""Recordings made for tests, by writers that share no code with the program: mcap, foxglove-sdk, rosbags."""

from __future__ import annotations

import base64
import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import cv2
import flatbuffers
import foxglove
import numpy as np
from foxglove import messages as sdk
from foxglove.channels import CompressedImageChannel
from foxglove.mcap import MCAPWriteOptions
from foxglove_schemas_flatbuffer import CompressedImage as FlatCompressedImage
from foxglove_schemas_flatbuffer import RawImage as FlatRawImage
from foxglove_schemas_flatbuffer.Time import CreateTime
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from mcap.writer import CompressionType, IndexType, Writer
from mcap_protobuf.schema import build_file_descriptor_set
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as BagWriter
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence
    from pathlib import Path
    from typing import Any

    from numpy.typing import NDArray

START_NS = 1_700_000_000_000_000_000
STEP_NS = 500_000_000
STAMP_LAG_NS = 7  # how much earlier an image's header stamp is than its log time
CAMERA = "/camera/image/compressed"
ROS2, FOXGLOVE_ROS2 = get_typestore(Stores.ROS2_HUMBLE), get_typestore(Stores.ROS2_HUMBLE)
ROS1 = get_typestore(Stores.ROS1_NOETIC)
for _name, _definition in {
    "CompressedImage": "builtin_interfaces/Time timestamp\nstring frame_id\nuint8[] data\nstring format\n",
    "RawImage": "builtin_interfaces/Time timestamp\nstring frame_id\nuint32 width\nuint32 height\n"
    "string encoding\nuint32 step\nuint8[] data\n",
}.items():
    FOXGLOVE_ROS2.register(get_types_from_msg(_definition, f"foxglove_msgs/msg/{_name}"))
UNINDEXED = IndexType.NONE
NO_CHUNK_INDEX = IndexType.ALL & ~IndexType.CHUNK
NO_MESSAGE_INDEX = IndexType.ALL & ~IndexType.MESSAGE


class Shot(NamedTuple):
    """An image message to write: which picture, on which topic, when."""

    number: int
    topic: str = CAMERA
    log_time_ns: int = START_NS
    data: bytes | RawPixels | None = None  # instead of the picture


@dataclass(frozen=True)
class Encoding:
    """How image messages are written: schema and encoding, and the message of (stamp, frame id, image)."""

    schema_name: str
    schema_encoding: str
    schema_data: bytes
    message_encoding: str
    encode: Callable[[int, str, bytes | RawPixels], bytes]


def shots(count: int, topic: str = CAMERA, *, start_ns: int = START_NS, step_ns: int = STEP_NS) -> list[Shot]:
    """`count` shots in order, picture i at start + i * step."""
    return [Shot(i, topic, start_ns + i * step_ns) for i in range(count)]


def picture(number: int) -> NDArray[np.uint8]:
    """A small RGB picture that is different for each number below 4096."""
    rows, columns = np.mgrid[0:12, 0:16]
    red, green = number % 64 * 4, number // 64 * 4
    return np.stack([np.full_like(rows, red), np.full_like(rows, green), rows * 16 + columns], -1).astype(
        np.uint8
    )


def encoded_picture(number: int, suffix: str = ".png") -> bytes:
    """The picture as a file of this type; PNG keeps it exactly."""
    return cv2.imencode(suffix, cv2.cvtColor(picture(number), cv2.COLOR_RGB2BGR))[1].tobytes()


def number_of(image: NDArray[np.uint8]) -> int:
    """Which picture an RGB image is; asserts that every pixel is right."""
    number = int(image[0, 0, 0]) // 4 + int(image[0, 0, 1]) // 4 * 64
    np.testing.assert_array_equal(image, picture(number))
    return number


class RawPixels(NamedTuple):
    """A raw image to write."""

    encoding: str
    height: int
    width: int
    step_bytes: int
    data: bytes
    is_big_endian: bool = False


def _protobuf(stamp_ns: int, frame_id: str, image: bytes | RawPixels) -> bytes:
    if isinstance(image, RawPixels):
        message = RawImage(
            frame_id=frame_id,
            width=image.width,
            height=image.height,
            encoding=image.encoding,
            step=image.step_bytes,
            data=image.data,
        )
    else:
        message = CompressedImage(frame_id=frame_id, data=image, format="png")
    message.timestamp.FromNanoseconds(stamp_ns)
    return message.SerializeToString()


def _json(stamp_ns: int, frame_id: str, image: bytes | RawPixels) -> bytes:
    stamp = {"sec": stamp_ns // 10**9, "nsec": stamp_ns % 10**9}
    fields = {"timestamp": stamp, "frame_id": frame_id}
    if isinstance(image, RawPixels):
        fields |= {"width": image.width, "height": image.height, "encoding": image.encoding}
        fields |= {"step": image.step_bytes, "data": base64.b64encode(image.data).decode()}
    else:
        fields |= {"data": base64.b64encode(image).decode(), "format": "png"}
    return json.dumps(fields).encode()


def _flatbuffer(stamp_ns: int, frame_id: str, image: bytes | RawPixels) -> bytes:
    builder = flatbuffers.Builder(0)
    is_raw = isinstance(image, RawPixels)
    module = FlatRawImage if is_raw else FlatCompressedImage
    frame_at = builder.CreateString(frame_id)
    data_at = builder.CreateByteVector(image.data if is_raw else image)
    name_at = builder.CreateString(image.encoding if is_raw else "png")
    module.Start(builder)
    module.AddTimestamp(builder, CreateTime(builder, stamp_ns // 10**9, stamp_ns % 10**9))
    module.AddFrameId(builder, frame_at)
    module.AddData(builder, data_at)
    if is_raw:
        module.AddEncoding(builder, name_at)
        module.AddWidth(builder, image.width)
        module.AddHeight(builder, image.height)
        module.AddStep(builder, image.step_bytes)
    else:
        module.AddFormat(builder, name_at)
    builder.Finish(module.End(builder))
    return bytes(builder.Output())


def _ros_message(store: Any, header: Any, image: bytes | RawPixels) -> tuple[Any, str]:
    if isinstance(image, RawPixels):
        data = np.frombuffer(image.data, np.uint8)
        fields = (image.height, image.width, image.encoding, int(image.is_big_endian), image.step_bytes, data)
        return store.types["sensor_msgs/msg/Image"](header, *fields), "sensor_msgs/msg/Image"
    kind = "sensor_msgs/msg/CompressedImage"
    return store.types[kind](header, "rgb8; jpeg compressed bgr8", np.frombuffer(image, np.uint8)), kind


def ros2_cdr(stamp_ns: int, frame_id: str, image: bytes | RawPixels, *, little_endian: bool = True) -> bytes:
    """A sensor_msgs image as rosbags serialises it."""
    stamp = ROS2.types["builtin_interfaces/msg/Time"](stamp_ns // 10**9, stamp_ns % 10**9)
    message, kind = _ros_message(ROS2, ROS2.types["std_msgs/msg/Header"](stamp, frame_id), image)
    return bytes(ROS2.serialize_cdr(message, kind, little_endian=little_endian))


def _ros1(stamp_ns: int, frame_id: str, image: bytes | RawPixels) -> bytes:
    stamp = ROS1.types["builtin_interfaces/msg/Time"](stamp_ns // 10**9, stamp_ns % 10**9)
    message, kind = _ros_message(ROS1, ROS1.types["std_msgs/msg/Header"](5, stamp, frame_id), image)
    return bytes(ROS1.serialize_ros1(message, kind))


def _foxglove_ros2(stamp_ns: int, frame_id: str, image: bytes | RawPixels) -> bytes:
    stamp = FOXGLOVE_ROS2.types["builtin_interfaces/msg/Time"](stamp_ns // 10**9, stamp_ns % 10**9)
    if isinstance(image, RawPixels):
        kind, data = "foxglove_msgs/msg/RawImage", np.frombuffer(image.data, np.uint8)
        fields = (image.width, image.height, image.encoding, image.step_bytes, data)
    else:
        kind, fields = "foxglove_msgs/msg/CompressedImage", (np.frombuffer(image, np.uint8), "png")
    message = FOXGLOVE_ROS2.types[kind](stamp, frame_id, *fields)
    return bytes(FOXGLOVE_ROS2.serialize_cdr(message, kind))


_PROTOBUF_SCHEMA = build_file_descriptor_set(CompressedImage).SerializeToString()
ENCODINGS = {
    "protobuf": Encoding("foxglove.CompressedImage", "protobuf", _PROTOBUF_SCHEMA, "protobuf", _protobuf),
    "json": Encoding("foxglove.CompressedImage", "jsonschema", b"{}", "json", _json),
    "flatbuffer": Encoding("foxglove.CompressedImage", "flatbuffer", b"", "flatbuffer", _flatbuffer),
    "ros2": Encoding("sensor_msgs/msg/CompressedImage", "ros2msg", b"", "cdr", ros2_cdr),
    "ros1": Encoding("sensor_msgs/CompressedImage", "ros1msg", b"", "ros1", _ros1),
    "foxglove ros2": Encoding("foxglove_msgs/msg/CompressedImage", "ros2msg", b"", "cdr", _foxglove_ros2),
}
RAW_ENCODINGS = {
    "protobuf": Encoding("foxglove.RawImage", "protobuf", b"", "protobuf", _protobuf),
    "json": Encoding("foxglove.RawImage", "jsonschema", b"{}", "json", _json),
    "flatbuffer": Encoding("foxglove.RawImage", "flatbuffer", b"", "flatbuffer", _flatbuffer),
    "ros2": Encoding("sensor_msgs/msg/Image", "ros2msg", b"", "cdr", ros2_cdr),
    "ros1": Encoding("sensor_msgs/Image", "ros1msg", b"", "ros1", _ros1),
    "foxglove ros2": Encoding("foxglove_msgs/msg/RawImage", "ros2msg", b"", "cdr", _foxglove_ros2),
}


def make_recording(
    path: Path,
    to_write: Sequence[Shot],
    *,
    encoding: str | Encoding = "protobuf",
    n_gps_per_shot: int = 2,
    attachments: Iterable[bytes] = (),
    metadata: dict[str, dict[str, str]] | None = None,
    **options: Any,
) -> Path:
    """Write shots in the given order with the mcap package; `options` are those of its Writer.

    Each shot is followed by JSON messages on /gps, so that there is something to pass over.
    """
    options = {"chunk_size": 2000, "compression": CompressionType.ZSTD, **options}
    how = ENCODINGS[encoding] if isinstance(encoding, str) else encoding
    with path.open("wb") as file:
        writer = Writer(file, **options)
        writer.start(profile="test")
        schema_id = writer.register_schema(how.schema_name, how.schema_encoding, how.schema_data)
        gps_id = writer.register_channel("/gps", "json", writer.register_schema("Gps", "jsonschema", b"{}"))
        channel_ids: dict[str, int] = {}
        for shot in to_write:
            if shot.topic not in channel_ids:
                channel_ids[shot.topic] = writer.register_channel(shot.topic, how.message_encoding, schema_id)
            data = encoded_picture(shot.number) if shot.data is None else shot.data
            payload = how.encode(shot.log_time_ns - STAMP_LAG_NS, "cam", data)
            writer.add_message(channel_ids[shot.topic], shot.log_time_ns, payload, shot.log_time_ns + 1)
            for i in range(n_gps_per_shot):
                writer.add_message(gps_id, shot.log_time_ns + i, b'{"latitude": 1}', shot.log_time_ns + i)
        for data in attachments:
            writer.add_attachment(START_NS, START_NS, "notes.txt", "text/plain", data)
        for name, fields in (metadata or {}).items():
            writer.add_metadata(name, fields)
        writer.finish()
    return path


def make_recording_with_sdk(path: Path, to_write: Iterable[Shot], **options: Any) -> Path:
    """Write shots with foxglove-sdk; `options` are those of its MCAPWriteOptions."""
    context = foxglove.Context()
    writer_options = MCAPWriteOptions(chunk_size=2000, **options)
    with foxglove.open_mcap(path, context=context, writer_options=writer_options):
        channels: dict[str, Any] = {}
        for shot in to_write:
            if shot.topic not in channels:
                channels[shot.topic] = CompressedImageChannel(shot.topic, context=context)
            stamp_ns = shot.log_time_ns - STAMP_LAG_NS
            message = sdk.CompressedImage(
                timestamp=sdk.Timestamp(stamp_ns // 10**9, stamp_ns % 10**9),
                frame_id="cam",
                data=encoded_picture(shot.number) if shot.data is None else shot.data,
                format="png",
            )
            channels[shot.topic].log(message, log_time=shot.log_time_ns)
    return path


def make_recording_with_rosbags(folder: Path, to_write: Iterable[Shot]) -> Path:
    """Write shots as a rosbag2 with rosbags; the one MCAP file in it."""
    message_type = "sensor_msgs/msg/CompressedImage"
    with BagWriter(folder, version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        connections: dict[str, Any] = {}
        for shot in to_write:
            if shot.topic not in connections:
                connections[shot.topic] = bag.add_connection(shot.topic, message_type, typestore=ROS2)
            data = encoded_picture(shot.number) if shot.data is None else shot.data
            payload = ros2_cdr(shot.log_time_ns - STAMP_LAG_NS, "cam", data)
            bag.write(connections[shot.topic], shot.log_time_ns, payload)
    (path,) = folder.glob("*.mcap")
    return path
