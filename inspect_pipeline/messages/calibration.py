"""Calibrations of cameras: sensor_msgs/CameraInfo and foxglove.CameraCalibration."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Any

from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration

from inspect_pipeline.geometry.camera import Intrinsics
from inspect_pipeline.messages.cdr import CdrReader, Ros1Reader
from inspect_pipeline.messages.flatbuffer import FlatbufferTable
from inspect_pipeline.messages.names import type_name

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from inspect_pipeline.messages.cdr import SequentialReader

    Parser = Callable[[memoryview], Intrinsics | None]


def parser_for(schema_name: str, message_encoding: str) -> Parser | None:
    """Return what parses the messages of a channel; None when they are not calibrations.

    The parser returns None for a camera that is not calibrated, and raises one of `errors.MALFORMED`.
    """
    return _PARSERS.get((type_name(schema_name), message_encoding))


def _intrinsics(
    width: int, height: int, model: str, d: Sequence[float], k: Sequence[float]
) -> Intrinsics | None:
    """Return None for a camera that is not calibrated: without focal length or image size."""
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


_PARSERS: dict[tuple[str, str], Parser] = {
    ("foxglove/CameraCalibration", "protobuf"): _protobuf,
    ("foxglove/CameraCalibration", "json"): _json,
    ("foxglove/CameraCalibration", "flatbuffer"): _flatbuffer,
    ("foxglove/CameraCalibration", "cdr"): _ros2_calibration,
    ("sensor_msgs/CameraInfo", "cdr"): lambda payload: _camera_info(CdrReader(payload)),
    ("sensor_msgs/CameraInfo", "ros1"): lambda payload: _camera_info(Ros1Reader(payload)),
}
