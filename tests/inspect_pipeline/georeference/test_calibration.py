from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import flatbuffers
import numpy as np
import pytest
from factories import CAMERA, ROS1, ROS2, START_NS, encoded_picture
from foxglove_schemas_flatbuffer import CameraCalibration as FlatCalibration
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from mcap.writer import CompressionType, Writer

from inspect_pipeline.geometry.camera import Intrinsics
from inspect_pipeline.georeference.calibration import LensReader
from inspect_pipeline.georeference.poses import read_poses
from inspect_pipeline.recording.reader import open_recording
from inspect_pipeline.recording.writer import new_recording

if TYPE_CHECKING:
    from pathlib import Path

    from inspect_pipeline.recording.reader import Recording

K = [900.0, 0.0, 639.5, 0.0, 901.0, 359.5, 0.0, 0.0, 1.0]
D = [0.1, -0.2, 0.001, 0.002, 0.05]
EXPECTED = Intrinsics((720, 1280), (900.0, 901.0), (640.0, 360.0), "plumb_bob", tuple(D))


def camera_info(store: Any) -> Any:
    time = store.types["builtin_interfaces/msg/Time"](1, 2)
    header = store.types["std_msgs/msg/Header"](*((3, time, "cam") if store is ROS1 else (time, "cam")))
    region = store.types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    matrices = (np.array(D), np.array(K), np.eye(3).ravel(), np.zeros(12))
    return store.types["sensor_msgs/msg/CameraInfo"](header, 720, 1280, "plumb_bob", *matrices, 0, 0, region)


def flat_calibration() -> bytes:
    builder = flatbuffers.Builder(0)
    vectors = [builder.CreateNumpyVector(np.array(values)) for values in (D, K)]
    model_at = builder.CreateString("plumb_bob")
    FlatCalibration.Start(builder)
    FlatCalibration.AddWidth(builder, 1280)
    FlatCalibration.AddHeight(builder, 720)
    FlatCalibration.AddDistortionModel(builder, model_at)
    FlatCalibration.AddD(builder, vectors[0])
    FlatCalibration.AddK(builder, vectors[1])
    builder.Finish(FlatCalibration.End(builder))
    return bytes(builder.Output())


def protobuf(k: list[float] = K, width: int = 1280) -> bytes:
    return CameraCalibration(
        width=width, height=720, distortion_model="plumb_bob", D=D, K=k
    ).SerializeToString()


def as_json() -> bytes:
    fields = {"width": 1280, "height": 720, "distortion_model": "plumb_bob", "D": D, "K": K}
    return json.dumps(fields).encode()


FOXGLOVE, KIND = "foxglove.CameraCalibration", "sensor_msgs/msg/CameraInfo"
MESSAGES = {
    "protobuf": (FOXGLOVE, "protobuf", protobuf()),
    "json": (FOXGLOVE, "json", as_json()),
    "flatbuffer": (FOXGLOVE, "flatbuffer", flat_calibration()),
    "ROS 2": (KIND, "cdr", bytes(ROS2.serialize_cdr(camera_info(ROS2), KIND))),
    "ROS 1": ("sensor_msgs/CameraInfo", "ros1", bytes(ROS1.serialize_ros1(camera_info(ROS1), KIND))),
}


def first_lenses(recording: Recording) -> list[Intrinsics | None]:
    """The first calibration of each camera."""
    reader = LensReader(recording)
    read_poses(recording, reader)
    lenses = reader.lenses()
    tracks = [lenses.get(camera.channel_id) for camera in recording.camera_channels]
    return [track.lenses[0] if track else None for track in tracks]


def write(
    path: Path,
    calibrations: list[tuple[str, str, str, bytes]],
    cameras: tuple[str, ...] = (CAMERA,),
    chunk_size: int = 1 << 20,
) -> list[Intrinsics | None]:
    """What is known of each camera in a recording of these, and of (topic, schema, encoding, message)."""
    image = CompressedImage(data=encoded_picture(0), format="png").SerializeToString()
    with path.open("wb") as file:
        writer = Writer(file, chunk_size, CompressionType.NONE)
        writer.start()
        images = [(topic, "foxglove.CompressedImage", "protobuf", image) for topic in cameras]
        for topic, schema, encoding, message in images + calibrations:
            schema_id = writer.register_schema(schema, encoding, b"")
            channel_id = writer.register_channel(topic, encoding, schema_id)
            writer.add_message(channel_id, START_NS, message, START_NS)
        writer.finish()
    recording = open_recording(path)
    return first_lenses(recording)


@pytest.mark.parametrize("name", MESSAGES)
def test_a_calibration_is_read(tmp_path: Path, name: str) -> None:
    (found,) = write(tmp_path / "a.mcap", [("/camera/camera_info", *MESSAGES[name])])
    assert found == EXPECTED


def test_a_calibration_that_was_written_here_is_read(tmp_path: Path) -> None:
    with new_recording(tmp_path / "a.mcap") as author:
        author.write_image(CAMERA, START_NS, "cam", encoded_picture(0), "png")
        author.write_calibration(
            "/camera/calibration",
            START_NS,
            "cam",
            image_size=(720, 1280),
            focal_px=(900.0, 901.0),
            centre_px=(640.0, 360.0),
            distortion=D,
        )
    recording = open_recording(tmp_path / "a.mcap")
    assert first_lenses(recording) == [EXPECTED]


def test_each_camera_has_its_own(tmp_path: Path) -> None:
    other = (FOXGLOVE, "protobuf", protobuf([500.0, *K[1:]]))
    calibrations = [("/left/info", *MESSAGES["protobuf"]), ("/right/info", *other)]
    cameras = ("/left/image", "/right/image", "/up/image")
    left, right, up = write(tmp_path / "a.mcap", calibrations, cameras)

    assert left == EXPECTED
    assert right is not None
    assert right.focal_px == (500.0, 901.0)
    assert up is None


@pytest.mark.parametrize(
    "message",
    [
        b"",
        b"\xff" * 9,
        protobuf([0.0] * 9),
        protobuf([900.0, *[0.0] * 8]),
        protobuf([float("nan"), *K[1:]]),
        protobuf(width=0),
    ],
)
def test_a_camera_that_is_not_calibrated_has_none(tmp_path: Path, message: bytes) -> None:
    assert write(tmp_path / "a.mcap", [("/camera/info", FOXGLOVE, "protobuf", message)]) == [None]


def test_a_lost_calibration_is_a_loss_of_the_recording(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    assert write(path, [("/camera/info", *MESSAGES["protobuf"])], chunk_size=1) == [EXPECTED]
    content = bytearray(path.read_bytes())
    content[content.index(b"plumb_bob")] ^= 1
    path.write_bytes(content)
    recording = open_recording(path)
    assert len(read_poses(recording, LensReader(recording)).losses) == 1


def test_lenses_of_many_cameras_are_read_at_once(tmp_path: Path) -> None:
    """Once per camera, this takes minutes."""
    n = 1500
    calibrations = [(f"/c{i}/info", FOXGLOVE, "protobuf", protobuf([900.0 + i, *K[1:]])) for i in range(n)]
    found = write(tmp_path / "a.mcap", calibrations, tuple(f"/c{i}/image" for i in range(n)))
    assert len({lens.focal_px for lens in found if lens}) == n
