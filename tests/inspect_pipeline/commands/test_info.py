from __future__ import annotations

from typing import TYPE_CHECKING

import typer
from factories import CAMERA, ROS2, START_NS, encoded_picture
from mcap.writer import Writer
from typer.testing import CliRunner

from inspect_pipeline.commands.info import info
from inspect_pipeline.geometry.attitude import YawPitchRoll, to_enu
from inspect_pipeline.recording.writer import new_recording

if TYPE_CHECKING:
    from pathlib import Path


def test_poses_lenses_and_what_is_odd_are_shown(tmp_path: Path) -> None:
    time_ns = START_NS // 1000  # microseconds by mistake
    with new_recording(tmp_path / "a.mcap") as author:
        author.write_location("/fix", time_ns, "gps", latitude_deg=48.0, longitude_deg=11.0, altitude_m=5.0)
        author.write_attitude("/tf", time_ns, "map", "gimbal", to_enu(YawPitchRoll(10, -90, 0)))
        author.write_calibration(
            "/camera/info", time_ns, "cam", image_size=(12, 16), focal_px=(20, 21), centre_px=(8, 6)
        )
        author.write_image(CAMERA, time_ns, "cam", encoded_picture(0), "png")
        author.write_image("/stereo/compressedDepth", time_ns, "cam", encoded_picture(0), "png")
    app = typer.Typer()
    app.command()(info)

    lines = CliRunner().invoke(app, [str(tmp_path / "a.mcap")]).stdout.splitlines()
    assert lines[-6:] == [
        "poses     1 positions, 1 attitudes of the camera",
        f"lens      {CAMERA}: 16x12, focal length 20.0 x 21.0 px",
        "spans     cannot be judged: height above ground unknown (--ground-alt)",
        "no camera /stereo/compressedDepth: it holds distances",
        "odd       its log times look like microseconds instead of nanoseconds",
        f"process   {CAMERA}",
    ]


def test_a_split_recording_is_shown_as_one(tmp_path: Path) -> None:
    for i in range(2):
        with new_recording(tmp_path / f"f_{i}.mcap") as author:
            author.write_image(CAMERA, START_NS + i, "cam", encoded_picture(i), "png")
    app = typer.Typer()
    app.command()(info)

    lines = CliRunner().invoke(app, [str(tmp_path)]).stdout.splitlines()
    assert lines[0].startswith(f"folder    {tmp_path} (2 parts, ")
    assert [line.split(":")[0] for line in lines[1:3]] == ["  f_0.mcap", "  f_1.mcap"]
    (channel,) = (line for line in lines if line.startswith(f"  {CAMERA}"))
    assert "2 messages" in channel
    assert lines[-1] == f"process   {CAMERA}"


def test_why_a_pose_topic_is_not_read_is_shown(tmp_path: Path) -> None:
    with (tmp_path / "a.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2")
        for topic, schema, data in (
            ("/odom", "nav_msgs/msg/Unheard_Odometry", b"\0\1\0\0"),
            ("/setpoint", "px4_msgs/msg/PositionSetpoint", b"\0\1\0\0"),
            ("/fix", "sensor_msgs/msg/NavSatFix", b"\0\1\0\0" + bytes(12) + b"\xff" + bytes(150)),
            ("/broken", "sensor_msgs/msg/NavSatFix", b"\0\1\0\0"),
            ("/pose", "geometry_msgs/msg/PoseStamped", ros2_pose("strange")),
        ):
            schema_id = writer.register_schema(schema, "ros2msg", b"")
            writer.add_message(writer.register_channel(topic, "cdr", schema_id), START_NS, data, START_NS)
        writer.finish()
    app = typer.Typer()
    app.command()(info)
    lines = CliRunner().invoke(app, [str(tmp_path / "a.mcap")]).stdout.splitlines()
    assert [line for line in lines if line.startswith("no pose")] == [
        "no pose   /broken: its messages are not sensor_msgs/msg/NavSatFix",
        "no pose   /fix: none of its first messages has a valid position",
        "no pose   /odom: nav_msgs/msg/Unheard_Odometry in cdr is not read",
        "no pose   /pose: its frames are not among those that are read",
    ]


def ros2_pose(frame_id: str) -> bytes:
    types = ROS2.types
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](1, 2), frame_id)
    point, turn = types["geometry_msgs/msg/Point"](0, 0, 9), types["geometry_msgs/msg/Quaternion"](0, 0, 0, 1)
    pose = types["geometry_msgs/msg/PoseStamped"](header, types["geometry_msgs/msg/Pose"](point, turn))
    return bytes(ROS2.serialize_cdr(pose, "geometry_msgs/msg/PoseStamped"))
