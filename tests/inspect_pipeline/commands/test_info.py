from __future__ import annotations

from typing import TYPE_CHECKING

import typer
from factories import CAMERA, START_NS, encoded_picture
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
    assert lines[-5:] == [
        "poses     1 positions, 1 attitudes of the camera",
        f"lens      {CAMERA}: 16x12, focal length 20.0 x 21.0 px",
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
