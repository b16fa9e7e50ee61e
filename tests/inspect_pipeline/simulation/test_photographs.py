"""Simulated photographs: read by GDAL, then packed."""

from __future__ import annotations

import json
import re
from fractions import Fraction
from typing import TYPE_CHECKING

import pytest
import rasterio

from inspect_pipeline.convert.photographs import pack_photographs
from inspect_pipeline.errors import OutputError
from inspect_pipeline.georeference.calibration import LensReader
from inspect_pipeline.georeference.poses import read_poses
from inspect_pipeline.recording.reader import open_recording
from inspect_pipeline.simulation.options import FaultKind, SchemaKind, SimulationOptions
from inspect_pipeline.simulation.write import simulate_flight

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
OPTIONS = SimulationOptions(
    seconds=6, fps=0.5, image_size=(288, 512), seed=3, schema=SchemaKind.PHOTOGRAPHS, hills_m=5
)


def test_photographs_say_where_and_when_they_were_taken(tmp_path: Path, flat_ground: None) -> None:
    folder = tmp_path / "DCIM"
    truth = json.loads(simulate_flight(folder, OPTIONS).read_text())
    assert [path.name for path in sorted(folder.iterdir())] == ["0001.jpg", "0002.jpg", "0003.jpg"]
    for path, frame in zip(sorted(folder.iterdir()), truth["frames"], strict=True):
        with rasterio.open(path) as image:
            assert (image.height, image.width) == (288, 512)
            tags, xmp = image.tags(), image.tags(ns="xml:XMP")["xml:XMP"]
        assert tags["EXIF_DateTimeOriginal"] == f"2026:05:04 09:30:{2 * frame['frame_idx']:02d}"
        for axis, column in (("Latitude", "lat_deg"), ("Longitude", "lon_deg")):
            degrees, minutes, seconds = map(float, re.findall(r"[\d.]+", tags[f"EXIF_GPS{axis}"]))
            assert degrees + minutes / 60 + seconds / 3600 == pytest.approx(frame[column], abs=5e-8)
        film_mm = Fraction(tags["EXIF_FocalLengthIn35mmFilm"])
        assert film_mm == pytest.approx(43.27 * frame["focal_px"] / (288**2 + 512**2) ** 0.5, abs=0.5)
        said = {name: float(value) for name, value in re.findall(r'drone-dji:(\w+)="([^"]+)"', xmp)}
        assert said["GimbalPitchDegree"] == pytest.approx(frame["cam_pitch_deg"], abs=1e-5)
        assert said["RelativeAltitude"] == pytest.approx(frame["height_m"], abs=1e-3)
    for taken in (folder, folder.with_suffix(".mcap")):  # whose truth would replace that of the photographs
        with pytest.raises(OutputError, match="it exists already"):
            simulate_flight(taken, OPTIONS)
    assert json.loads((tmp_path / "DCIM.truth.json").read_text()) == truth
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith(".")] == []


def test_packed_photographs_have_the_poses_of_the_truth(tmp_path: Path, flat_ground: None) -> None:
    folder, recording = tmp_path / "DCIM", tmp_path / "packed.mcap"
    truth = json.loads(simulate_flight(folder, OPTIONS).read_text())
    assert pack_photographs(folder, recording).counts == {"images": 3, "positions": 3, "attitudes": 3}
    packed = open_recording(recording)
    (camera,) = packed.camera_channels
    assert (camera.topic, camera.is_stills) == (truth["image_topic"], True)
    poses = read_poses(packed, LensReader(packed))
    for frame in truth["frames"]:
        pose = poses.at(frame["log_time_ns"])
        found = [pose.latitude_deg, pose.longitude_deg, pose.height_m, pose.yaw_deg, pose.pitch_deg]
        names = ("lat_deg", "lon_deg", "height_m", "cam_yaw_deg", "cam_pitch_deg")
        assert found == pytest.approx([frame[name] for name in names], abs=1e-3)


def test_a_clock_that_steps_and_a_dropout_show_in_the_names_and_times(
    tmp_path: Path, flat_ground: None
) -> None:
    options = SimulationOptions(
        seconds=20,
        fps=1,
        image_size=(64, 96),
        schema=SchemaKind.PHOTOGRAPHS,
        faults=(FaultKind.DROPOUT, FaultKind.CLOCK_STEP),
    )
    truth = json.loads(simulate_flight(tmp_path / "a", options).read_text())
    taken = [frame for frame in truth["frames"] if frame["frame_idx"] is not None]
    files = sorted((tmp_path / "a").iterdir())
    assert len(files) == len(taken) < 20
    with rasterio.open(files[-1]) as image:
        tags = image.tags()
    seconds = float(tags["EXIF_DateTimeOriginal"][-2:]) + float(f"0.{tags['EXIF_SubSecTime_Original']}")
    assert seconds == pytest.approx(taken[-1]["stamp_ns"] / 1e9 % 60, abs=1e-5)
