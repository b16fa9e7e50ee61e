"""What a recording knows of its cameras' lenses: sensor_msgs/CameraInfo and foxglove.CameraCalibration."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from itertools import takewhile
from typing import TYPE_CHECKING, Any

from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration

from inspect_pipeline.messages.flatbuffer import MALFORMED, CdrReader, FlatbufferTable, Ros1Reader
from inspect_pipeline.recording.frames import iter_channel_messages

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from inspect_pipeline.messages.flatbuffer import SequentialReader
    from inspect_pipeline.recording.reader import Recording
    from inspect_pipeline.recording.types import CameraChannel, ChannelSummary


@dataclass(frozen=True, slots=True)
class Intrinsics:
    """A pinhole camera with distortion, of the image as it is stored.

    image_size is (height, width); focal_px and centre_px are (x, y), the centre counted from the top-left
    corner of the top-left pixel. `distortion` holds the coefficients of the model, such as k1, k2, p1, p2,
    k3 of "plumb_bob"; all zero or none without distortion.
    """

    image_size: tuple[int, int]
    focal_px: tuple[float, float]
    centre_px: tuple[float, float]
    distortion_model: str
    distortion: tuple[float, ...]


def read_intrinsics(recording: Recording, camera: CameraChannel) -> Intrinsics | None:
    """The first calibration of a camera, None when there is none.

    It is looked for on the topic that has most of its beginning in common with the camera's, as viewers do;
    one that has nothing in common is that of a recording with one camera.
    Raises RecordingError when chunks cannot be read of a `strict` recording.
    """
    channels = [c for c in recording.channels if (c.schema_name, c.message_encoding) in _PARSERS]
    n_least = 1 if len(recording.camera_channels) > 1 else 0
    common = {channel: _n_common_parts(channel.topic, camera.topic) for channel in channels}
    for channel in sorted(channels, key=lambda channel: (-common[channel], channel.topic)):
        found = _first(recording, channel) if common[channel] >= n_least else None
        if found:
            return found
    return None


def _n_common_parts(topic: str, other: str) -> int:
    pairs = zip(topic.strip("/").split("/"), other.strip("/").split("/"), strict=False)
    return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], pairs))


def _first(recording: Recording, channel: ChannelSummary) -> Intrinsics | None:
    parse = _PARSERS[channel.schema_name, channel.message_encoding]
    for message in iter_channel_messages(recording, {channel.channel_id}):
        try:
            found = parse(message.data)
        except MALFORMED:
            continue
        if found:
            return found
    return None


def _intrinsics(
    width: int, height: int, model: str, d: Sequence[float], k: Sequence[float]
) -> Intrinsics | None:
    """None for a camera that is not calibrated: without a focal length, or without the size it is for."""
    fx, _, cx, _, fy, cy = k[:6]
    if not all(math.isfinite(value) and value > 0 for value in (fx, fy, width, height)):
        return None
    # Calibrations count from the centre of the top-left pixel.
    return Intrinsics((height, width), (fx, fy), (cx + 0.5, cy + 0.5), model, tuple(d))


def _camera_info(reader: SequentialReader) -> Intrinsics | None:
    reader.header()
    height, width, model = reader.uint32(), reader.uint32(), reader.string()
    return _intrinsics(width, height, model, reader.float64s(), reader.float64s(9))


def _ros2_calibration(payload: memoryview) -> Intrinsics | None:
    reader = CdrReader(payload)
    reader.header()
    width, height, model = reader.uint32(), reader.uint32(), reader.string()
    return _intrinsics(width, height, model, reader.float64s(), reader.float64s(9))


def _protobuf(payload: memoryview) -> Intrinsics | None:
    message = CameraCalibration.FromString(bytes(payload))
    return _intrinsics(message.width, message.height, message.distortion_model, message.D, message.K)


def _json(payload: memoryview) -> Intrinsics | None:
    fields: dict[str, Any] = json.loads(bytes(payload))
    size = int(fields["width"]), int(fields["height"])
    d, k = ([float(value) for value in fields[name]] for name in "DK")
    return _intrinsics(*size, str(fields["distortion_model"]), d, k)


def _flatbuffer(payload: memoryview) -> Intrinsics | None:
    table = FlatbufferTable(payload)
    size = table.uint32(2), table.uint32(3)
    return _intrinsics(*size, table.string(4), table.float64s(5), table.float64s(6))


_PARSERS: dict[tuple[str, str], Callable[[memoryview], Intrinsics | None]] = {
    ("foxglove.CameraCalibration", "protobuf"): _protobuf,
    ("foxglove.CameraCalibration", "json"): _json,
    ("foxglove.CameraCalibration", "flatbuffer"): _flatbuffer,
    ("foxglove_msgs/msg/CameraCalibration", "cdr"): _ros2_calibration,
    ("sensor_msgs/msg/CameraInfo", "cdr"): lambda payload: _camera_info(CdrReader(payload)),
    ("sensor_msgs/CameraInfo", "ros1"): lambda payload: _camera_info(Ros1Reader(payload)),
}
