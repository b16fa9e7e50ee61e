"""Recordings made for tests, by writers that share no code with the program: mcap, foxglove-sdk, rosbags."""

from __future__ import annotations

import base64
import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import cv2
import foxglove
import numpy as np
from foxglove import messages as sdk
from foxglove.channels import CompressedImageChannel
from foxglove.mcap import MCAPWriteOptions
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from mcap.writer import CompressionType, IndexType, Writer
from mcap_protobuf.schema import build_file_descriptor_set
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as BagWriter
from rosbags.typesys import Stores, get_typestore

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence
    from pathlib import Path
    from typing import Any

    from numpy.typing import NDArray

START_NS = 1_700_000_000_000_000_000
STEP_NS = 500_000_000
STAMP_LAG_NS = 7  # how much earlier an image's header stamp is than its log time
CAMERA = "/camera/image/compressed"
ROS2 = get_typestore(Stores.ROS2_HUMBLE)
UNINDEXED = IndexType.NONE
NO_CHUNK_INDEX = IndexType.ALL & ~IndexType.CHUNK
NO_MESSAGE_INDEX = IndexType.ALL & ~IndexType.MESSAGE


class Shot(NamedTuple):
    """An image message to write: which picture, on which topic, when."""

    number: int
    topic: str = CAMERA
    log_time_ns: int = START_NS
    data: bytes | None = None  # instead of the picture


@dataclass(frozen=True)
class Encoding:
    """How image messages are written: schema and encoding, and the message of (stamp, frame id, image)."""

    schema_name: str
    schema_encoding: str
    schema_data: bytes
    message_encoding: str
    encode: Callable[[int, str, bytes], bytes]


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


def _foxglove_protobuf(stamp_ns: int, frame_id: str, data: bytes) -> bytes:
    message = CompressedImage(frame_id=frame_id, data=data, format="png")
    message.timestamp.FromNanoseconds(stamp_ns)
    return message.SerializeToString()


def _foxglove_json(stamp_ns: int, frame_id: str, data: bytes) -> bytes:
    stamp = {"sec": stamp_ns // 10**9, "nsec": stamp_ns % 10**9}
    fields = {
        "timestamp": stamp,
        "frame_id": frame_id,
        "data": base64.b64encode(data).decode(),
        "format": "png",
    }
    return json.dumps(fields).encode()


def ros2_compressed_image(stamp_ns: int, frame_id: str, data: bytes) -> Any:
    """A sensor_msgs/msg/CompressedImage of rosbags."""
    stamp = ROS2.types["builtin_interfaces/msg/Time"](stamp_ns // 10**9, stamp_ns % 10**9)
    header = ROS2.types["std_msgs/msg/Header"](stamp, frame_id)
    return ROS2.types["sensor_msgs/msg/CompressedImage"](header, "jpeg", np.frombuffer(data, np.uint8))


def _ros2(stamp_ns: int, frame_id: str, data: bytes) -> bytes:
    message = ros2_compressed_image(stamp_ns, frame_id, data)
    return bytes(ROS2.serialize_cdr(message, "sensor_msgs/msg/CompressedImage"))


ENCODINGS = {
    "protobuf": Encoding(
        "foxglove.CompressedImage",
        "protobuf",
        build_file_descriptor_set(CompressedImage).SerializeToString(),
        "protobuf",
        _foxglove_protobuf,
    ),
    "json": Encoding("foxglove.CompressedImage", "jsonschema", b"{}", "json", _foxglove_json),
    "ros2": Encoding("sensor_msgs/msg/CompressedImage", "ros2msg", b"", "cdr", _ros2),
}


def make_recording(
    path: Path,
    to_write: Sequence[Shot],
    *,
    encoding: str = "protobuf",
    n_gps_per_shot: int = 2,
    attachments: Iterable[bytes] = (),
    metadata: dict[str, dict[str, str]] | None = None,
    **options: Any,
) -> Path:
    """Write shots in the given order with the mcap package; `options` are those of its Writer.

    Each shot is followed by JSON messages on /gps, so that there is something to pass over.
    """
    options = {"chunk_size": 2000, "compression": CompressionType.ZSTD, **options}
    how = ENCODINGS[encoding]
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
            message = ros2_compressed_image(shot.log_time_ns - STAMP_LAG_NS, "cam", data)
            bag.write(connections[shot.topic], shot.log_time_ns, ROS2.serialize_cdr(message, message_type))
    (path,) = folder.glob("*.mcap")
    return path
