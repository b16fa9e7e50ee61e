from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Any

import flatbuffers
import foxglove
import numpy as np
import pytest
from factories import ROS1, ROS2, START_NS, make_recording, shots
from foxglove import channels
from foxglove import messages as sdk
from foxglove_schemas_flatbuffer import FrameTransform as FlatTransform
from foxglove_schemas_flatbuffer import LocationFix as FlatLocation
from foxglove_schemas_flatbuffer import Quaternion as FlatQuaternion
from foxglove_schemas_flatbuffer.Time import CreateTime
from mcap.writer import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

from inspect_pipeline.geometry.attitude import YawPitchRoll
from inspect_pipeline.georeference.poses import Pose, PoseTrack, read_poses
from inspect_pipeline.recording.frames import iter_frames
from inspect_pipeline.recording.reader import open_recording

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

SECOND_NS = 10**9
WHERE = (48.137, 11.575, 519.25)
TURNS = YawPitchRoll(120.0, -35.0, 4.0)
GPS_DEFINITION = """# a receiver
uint64 timestamp
uint8 FIX_TYPE_3D = 3
uint8 fix_type
float64 latitude_deg  # degrees
float64 longitude_deg
float64 altitude_msl_m
bool vel_ned_valid
float64 altitude_ellipsoid_m
"""
ATTITUDE_DEFINITION = "uint64 timestamp\nuint64 timestamp_sample\nfloat32[4] q\nfloat32[4] delta_q_reset\n"
PX4 = get_typestore(Stores.ROS2_HUMBLE)
PX4.register(get_types_from_msg(GPS_DEFINITION, "px4_msgs/msg/SensorGps"))
PX4.register(get_types_from_msg(ATTITUDE_DEFINITION, "px4_msgs/msg/VehicleAttitude"))
TRANSFORM = "foxglove.FrameTransform"
Row = tuple[str, str, str, bytes, bytes]  # topic, schema, encoding, schema data, message


def write(path: Path, rows: Iterable[Row], step_ns: int = SECOND_NS) -> PoseTrack:
    """A recording of one message per step, read."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel_ids: dict[str, int] = {}
        for i, (topic, schema, encoding, schema_data, message) in enumerate(rows):
            if topic not in channel_ids:
                schema_id = writer.register_schema(schema, encoding, schema_data)
                channel_ids[topic] = writer.register_channel(topic, encoding, schema_id)
            time_ns = START_NS + i * step_ns
            writer.add_message(channel_ids[topic], time_ns, message, time_ns)
        writer.finish()
    return read_poses(open_recording(path))


def json_row(topic: str, schema: str, **fields: Any) -> Row:
    return topic, schema, "json", b"{}", json.dumps(fields).encode()


def ned(turns: YawPitchRoll) -> list[float]:
    """w, x, y, z of the rotation that takes forward, right, down to north, east, down."""
    return Rotation.from_euler("ZYX", turns, degrees=True).as_quat(scalar_first=True).tolist()


def enu(turns: YawPitchRoll) -> list[float]:
    """w, x, y, z of the same, from forward, left, up to east, north, up."""
    to_enu = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
    matrix = to_enu @ Rotation.from_euler("ZYX", turns, degrees=True).as_matrix() @ np.diag([1, -1, -1])
    return Rotation.from_matrix(matrix).as_quat(scalar_first=True).tolist()


def nav_sat_fix(store: Any, *, status: int = 0) -> Any:
    time = store.types["builtin_interfaces/msg/Time"](1, 2)
    header_args = (3, time, "gps") if store is ROS1 else (time, "gps")
    header = store.types["std_msgs/msg/Header"](*header_args)
    fix_status = store.types["sensor_msgs/msg/NavSatStatus"](status, 1)
    return store.types["sensor_msgs/msg/NavSatFix"](header, fix_status, *WHERE, np.zeros(9), 0)


def flat_location() -> bytes:
    builder = flatbuffers.Builder(0)
    frame_at = builder.CreateString("gps")
    FlatLocation.Start(builder)
    FlatLocation.AddTimestamp(builder, CreateTime(builder, 1, 2))
    FlatLocation.AddFrameId(builder, frame_at)
    FlatLocation.AddLatitude(builder, WHERE[0])
    FlatLocation.AddLongitude(builder, WHERE[1])
    FlatLocation.AddAltitude(builder, WHERE[2])
    builder.Finish(FlatLocation.End(builder))
    return bytes(builder.Output())


def flat_transform(turns: YawPitchRoll) -> bytes:
    builder = flatbuffers.Builder(0)
    parent_at, child_at = builder.CreateString("map"), builder.CreateString("base_link")
    w, x, y, z = enu(turns)
    FlatQuaternion.Start(builder)
    FlatQuaternion.AddX(builder, x)
    FlatQuaternion.AddY(builder, y)
    FlatQuaternion.AddZ(builder, z)
    FlatQuaternion.AddW(builder, w)
    rotation_at = FlatQuaternion.End(builder)
    FlatTransform.Start(builder)
    FlatTransform.AddParentFrameId(builder, parent_at)
    FlatTransform.AddChildFrameId(builder, child_at)
    FlatTransform.AddRotation(builder, rotation_at)
    builder.Finish(FlatTransform.End(builder))
    return bytes(builder.Output())


def positions() -> dict[str, Row]:
    kind = "sensor_msgs/msg/NavSatFix"
    cdr = bytes(ROS2.serialize_cdr(nav_sat_fix(ROS2), kind))
    big_endian = bytes(ROS2.serialize_cdr(nav_sat_fix(ROS2), kind, little_endian=False))
    gps = PX4.types["px4_msgs/msg/SensorGps"](7, 3, *WHERE[:2], 470.0, True, WHERE[2])
    px4 = bytes(PX4.serialize_cdr(gps, "px4_msgs/msg/SensorGps"))
    latitude, longitude, altitude = WHERE
    old = {"lat": round(latitude * 1e7), "lon": round(longitude * 1e7), "alt": 470_000}
    return {
        "NavSatFix, ROS 2": ("/fix", kind, "cdr", b"", cdr),
        "NavSatFix, big-endian": ("/fix", kind, "cdr", b"", big_endian),
        "NavSatFix, ROS 1": (
            "/fix",
            "sensor_msgs/NavSatFix",
            "ros1",
            b"",
            bytes(ROS1.serialize_ros1(nav_sat_fix(ROS1), kind)),
        ),
        "LocationFix, JSON": json_row(
            "/fix", "foxglove.LocationFix", latitude=latitude, longitude=longitude, altitude=altitude
        ),
        "LocationFix, FlatBuffers": ("/fix", "foxglove.LocationFix", "flatbuffer", b"", flat_location()),
        "SensorGps": (
            "/fmu/out/vehicle_gps_position",
            "px4_msgs/msg/SensorGps",
            "cdr",
            GPS_DEFINITION.encode(),
            px4,
        ),
        "ULog before PX4 1.14": json_row(
            "/vehicle_gps_position_00", "", fix_type=3, alt_ellipsoid=round(altitude * 1e3), **old
        ),
        "ULog since PX4 1.14": json_row(
            "/g", "sensor_gps", latitude_deg=latitude, longitude_deg=longitude, altitude_ellipsoid_m=altitude
        ),
        "vehicle_global_position": json_row(
            "/g", "vehicle_global_position", lat=latitude, lon=longitude, alt=470.0, alt_ellipsoid=altitude
        ),
    }


@pytest.mark.parametrize("name", positions())
def test_a_position_is_read(tmp_path: Path, name: str) -> None:
    pose = write(tmp_path / "a.mcap", [positions()[name]]).at(START_NS + 2_500_000)

    assert pose is not None
    assert (pose.latitude_deg, pose.longitude_deg, pose.altitude_m) == pytest.approx(WHERE, abs=1e-7)
    assert pose.age_ms == 2.5
    assert (pose.yaw_deg, pose.attitude_of) == (None, None)


def attitudes() -> dict[str, tuple[Row, str]]:
    quaternion = dict(zip("wxyz", enu(TURNS), strict=True))
    message = PX4.types["px4_msgs/msg/VehicleAttitude"](
        1, 2, np.array(ned(TURNS), np.float32), np.zeros(4, np.float32)
    )
    px4 = bytes(PX4.serialize_cdr(message, "px4_msgs/msg/VehicleAttitude"))
    pose = {"orientation": quaternion, "position": {"x": 1, "y": 2, "z": 3}}
    flat_q = {f"q[{i}]": value for i, value in enumerate(ned(TURNS))}
    stamped = ROS2.types["geometry_msgs/msg/PoseStamped"](
        ROS2.types["std_msgs/msg/Header"](ROS2.types["builtin_interfaces/msg/Time"](1, 2), "map"),
        ROS2.types["geometry_msgs/msg/Pose"](
            ROS2.types["geometry_msgs/msg/Point"](1.0, 2.0, 3.0),
            ROS2.types["geometry_msgs/msg/Quaternion"](*(quaternion[axis] for axis in "xyzw")),
        ),
    )
    cdr = bytes(ROS2.serialize_cdr(stamped, "geometry_msgs/msg/PoseStamped"))
    transform = {"parent_frame_id": "map", "rotation": quaternion}
    definition = ATTITUDE_DEFINITION.encode()
    return {
        "PoseInFrame": (json_row("/pose", "foxglove.PoseInFrame", frame_id="map", pose=pose), "vehicle"),
        "PoseInFrame of a gimbal": (
            json_row("/gimbal/pose", "foxglove.PoseInFrame", frame_id="map", pose=pose),
            "camera",
        ),
        "PoseStamped": (("/pose", "geometry_msgs/msg/PoseStamped", "cdr", b"", cdr), "vehicle"),
        "FrameTransform of a camera": (
            json_row("/tf", TRANSFORM, child_frame_id="camera_link", **transform),
            "camera",
        ),
        "FrameTransform, FlatBuffers": (
            ("/tf", TRANSFORM, "flatbuffer", b"", flat_transform(TURNS)),
            "vehicle",
        ),
        "VehicleAttitude": (
            ("/fmu/out/vehicle_attitude", "px4_msgs/msg/VehicleAttitude", "cdr", definition, px4),
            "vehicle",
        ),
        "ULog": (json_row("/vehicle_attitude_00", "", q=ned(TURNS)), "vehicle"),
        "ULog by pyulog": (json_row("/v", "vehicle_attitude", **flat_q), "vehicle"),
        "gimbal with locked yaw": (
            json_row("/gimbal_device_attitude_status", "", q=ned(TURNS), device_flags=16),
            "camera",
        ),
    }


@pytest.mark.parametrize("name", attitudes())
def test_an_attitude_is_read(tmp_path: Path, name: str) -> None:
    row, attitude_of = attitudes()[name]
    pose = write(tmp_path / "a.mcap", [row]).at(START_NS)

    assert pose is not None
    assert (pose.yaw_deg, pose.pitch_deg, pose.roll_deg) == pytest.approx(TURNS, abs=1e-3)
    assert pose.attitude_of == attitude_of
    assert pose.latitude_deg is None


def test_what_foxglove_sdk_writes_is_read(tmp_path: Path) -> None:
    context, path = foxglove.Context(), tmp_path / "a.mcap"
    w, x, y, z = enu(TURNS)
    with foxglove.open_mcap(path, context=context):
        rotation = sdk.Quaternion(x=x, y=y, z=z, w=w)
        pose = sdk.Pose(position=sdk.Vector3(x=1, y=2, z=3), orientation=rotation)
        fix = sdk.LocationFix(latitude=WHERE[0], longitude=WHERE[1], altitude=WHERE[2])
        transform = sdk.FrameTransform(parent_frame_id="map", child_frame_id="gimbal", rotation=rotation)
        in_frame = sdk.PoseInFrame(frame_id="world", pose=pose)
        channels.LocationFixChannel("/fix", context=context).log(fix, log_time=START_NS)
        channels.FrameTransformChannel("/tf", context=context).log(transform, log_time=START_NS)
        channels.PoseInFrameChannel("/pose", context=context).log(in_frame, log_time=START_NS)
    track = read_poses(open_recording(path))

    found = track.at(START_NS)
    assert found is not None
    assert (found.latitude_deg, found.longitude_deg, found.altitude_m) == WHERE
    assert (found.yaw_deg, found.pitch_deg, found.roll_deg) == pytest.approx(TURNS)
    assert found.attitude_of == "camera"
    assert track.vehicle.values[0] == pytest.approx(TURNS)


@pytest.mark.parametrize(
    "row",
    [
        ("/fix", "sensor_msgs/msg/NavSatFix", "cdr", b"", b"\0\1\0\0short"),
        (
            "/fix",
            "sensor_msgs/msg/NavSatFix",
            "cdr",
            b"",
            bytes(ROS2.serialize_cdr(nav_sat_fix(ROS2, status=-1), "sensor_msgs/msg/NavSatFix")),
        ),
        json_row("/fix", "foxglove.LocationFix", latitude=0, longitude=0, altitude=0),
        json_row("/fix", "foxglove.LocationFix", latitude=math.nan, longitude=1.0),
        json_row("/fix", "foxglove.LocationFix", latitude="north"),
        json_row("/vehicle_gps_position", "", fix_type=0, lat=1, lon=1, alt=1),
        json_row("/vehicle_attitude", "", q=[0, 0, 0, 0]),
        json_row("/vehicle_attitude", "", q=[10**400, 0, 0, 0]),
        json_row("/vehicle_gps_position", "", lat=10**400, lon=1, alt=1),
        json_row("/vehicle_global_position", "", lat=1.0, lon=1.0, alt="high"),
        json_row("/vehicle_attitude", ""),
        json_row(
            "/tf",
            "foxglove.FrameTransform",
            parent_frame_id="base_link",
            child_frame_id="camera",
            rotation={"w": 1},
        ),
        json_row("/pose", "foxglove.PoseInFrame", frame_id="camera_optical", pose={"orientation": {"w": 1}}),
        ("/tf", TRANSFORM, "flatbuffer", b"", b"\xff" * 8),
        ("/tf", TRANSFORM, "protobuf", b"", b"\xff" * 8),
        ("/a", "px4_msgs/msg/VehicleAttitude", "cdr", b"", b"\0\1\0\0"),
    ],
)
def test_messages_that_say_nothing_are_passed_over(tmp_path: Path, row: Row) -> None:
    assert write(tmp_path / "a.mcap", [row]).at(START_NS + SECOND_NS) is None


@pytest.mark.parametrize("no_height_m", [math.inf, -math.inf, math.nan])
def test_heights_without_end_are_not_known(tmp_path: Path, no_height_m: float) -> None:
    pose = {"position": {"x": 1.0, "z": no_height_m}, "orientation": {"w": 1.0}}
    rows = [
        json_row("/fix", "foxglove.LocationFix", latitude=1.0, longitude=5.0, altitude=no_height_m),
        json_row("/pose", "foxglove.PoseInFrame", frame_id="map", pose=pose),
    ]
    found = write(tmp_path / "a.mcap", rows).at(START_NS + 2 * SECOND_NS)
    assert found is not None
    assert (found.latitude_deg, found.altitude_m, found.height_m, found.yaw_deg) == (1.0, None, None, 90.0)


def test_the_pose_is_the_last_one_known_and_its_age_that_of_its_oldest_part(tmp_path: Path) -> None:
    rows = [
        json_row("/fix", "foxglove.LocationFix", latitude=1.0, longitude=5.0),
        json_row("/vehicle_attitude", "", q=ned(YawPitchRoll(10, 0, 0))),
        json_row("/fix", "foxglove.LocationFix", latitude=3.0, longitude=5.0, altitude=7.0),
    ]
    track = write(tmp_path / "a.mcap", rows)

    assert track.at(START_NS - 1) is None
    assert track.at(START_NS) == Pose(1.0, 5.0, None, None, None, None, None, 0.0)
    pose = track.at(START_NS + 3 * SECOND_NS)
    assert pose is not None
    assert (pose.latitude_deg, pose.altitude_m, pose.age_ms) == (3.0, 7.0, 2000.0)
    assert pose.yaw_deg == pytest.approx(10)


def test_a_gimbal_that_follows_counts_its_yaw_from_the_vehicle(tmp_path: Path) -> None:
    rows = [
        json_row("/gimbal_device_attitude_status", "", q=ned(YawPitchRoll(30, -90, 0)), device_flags=0),
        json_row("/vehicle_attitude", "", q=ned(YawPitchRoll(170, 5, 1))),
    ]
    track = write(tmp_path / "a.mcap", rows)

    assert track.at(START_NS) is None  # against north it is not known yet
    pose = track.at(START_NS + SECOND_NS)
    assert pose is not None
    assert pose.attitude_of == "camera"
    assert (pose.yaw_deg, pose.pitch_deg) == pytest.approx((-160, -90))


def test_of_several_receivers_the_one_with_most_positions_counts(tmp_path: Path) -> None:
    def fix(topic: str, latitude: float) -> Row:
        return json_row(topic, "foxglove.LocationFix", latitude=latitude, longitude=5.0)

    track = write(
        tmp_path / "a.mcap", [fix("/a", 1.0), fix("/b", 2.0), fix("/b", 2.5), fix("/a", 1.5), fix("/b", 3.0)]
    )
    assert track.positions.values[:, 0].tolist() == [2.0, 2.5, 3.0]


def test_a_recording_without_poses_has_none(tmp_path: Path) -> None:
    recording = open_recording(make_recording(tmp_path / "a.mcap", shots(3)))
    assert read_poses(recording).at(recording.end_ns) is None


@pytest.mark.parametrize("name", ["caliterra_foxglove", "brighton_ros2"])
def test_frames_of_real_flights_have_poses(data_dir: Path, name: str) -> None:
    recording = open_recording(data_dir / "mcap" / f"{name}.mcap")
    track = read_poses(recording)
    for frame in iter_frames(recording, every=10):
        pose = track.at(frame.log_time_ns)
        assert pose is not None
        assert pose.altitude_m is not None
        assert pose.age_ms < 1000
