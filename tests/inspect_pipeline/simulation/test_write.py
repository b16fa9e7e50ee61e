"""Simulated recordings: read back by the plain reader, their truth checked against their pictures."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from mcap.reader import make_reader

import cli
from inspect_pipeline.errors import OutputError
from inspect_pipeline.images.quality import measure_quality
from inspect_pipeline.recording.frames import iter_frames
from inspect_pipeline.recording.reader import open_recording
from inspect_pipeline.simulation import ground as simulate_ground
from inspect_pipeline.simulation.ground import lay_photograph
from inspect_pipeline.simulation.options import RenderKind
from inspect_pipeline.simulation.power_line import hang_line
from inspect_pipeline.simulation.scene import Gaze, look, visible_parts
from inspect_pipeline.simulation.write import SimulationOptions, simulate_flight

if TYPE_CHECKING:
    from numpy.typing import NDArray

OPTIONS = SimulationOptions(seconds=1, fps=2, image_size=(360, 640), seed=3)


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory, small_ground: None) -> Path:
    path = tmp_path_factory.mktemp("flight") / "demo.mcap"
    assert simulate_flight(path, OPTIONS) == path.with_name("demo.truth.json")
    return path


def read(path: Path, kind: Any, topic: str) -> list[tuple[int, Any]]:
    with path.open("rb") as file:
        messages = make_reader(file).iter_messages([topic])
        return [
            (m.log_time, kind.FromString(m.data))
            for schema, _, m in messages
            if schema.encoding == "protobuf"
        ]


def pixels_of(message: CompressedImage) -> NDArray[np.uint8]:
    return cv2.imdecode(np.frombuffer(message.data, np.uint8), cv2.IMREAD_GRAYSCALE)


def truth_of(path: Path) -> list[dict[str, Any]]:
    return json.loads(path.with_name("demo.truth.json").read_text())["frames"]


def test_the_recording_holds_images_positions_and_calibrations(flight: Path) -> None:
    images = read(flight, CompressedImage, "/camera/image")
    assert [pixels_of(image).shape for _, image in images] == [(360, 640)] * 2
    assert [time for time, _ in images] == [frame["log_time_ns"] for frame in truth_of(flight)]
    assert all(image.timestamp.ToNanoseconds() == time for time, image in images)
    ((_, first), *_) = calibrations = read(flight, CameraCalibration, "/camera/calibration")
    assert len(calibrations) == 2
    assert (first.width, first.height, first.K[2], first.K[5]) == (640, 360, 319.5, 179.5)
    positions = [fix for _, fix in read(flight, LocationFix, "/drone/location")]
    assert len(positions) == 6  # ten a second until the last image
    east_m = (positions[-1].longitude - positions[0].longitude) * 111_320 * np.cos(np.deg2rad(52.09))
    north_m = (positions[-1].latitude - positions[0].latitude) * 111_250
    assert np.hypot(east_m, north_m) == pytest.approx(2.5, abs=0.05)


def test_the_truth_lies_on_the_conductors(flight: Path) -> None:
    """Across each line the picture is brightest in the middle: conductors are lighter than the ground."""
    offsets = np.arange(-4, 4.1, 0.5)
    images = [
        pixels_of(message).astype(np.float32) for _, message in read(flight, CompressedImage, "/camera/image")
    ]
    for image, frame in zip(images, truth_of(flight), strict=True):
        assert len(frame["lines"]) == 4
        for line in frame["lines"]:
            points = np.array(line["points"])
            along = np.diff(points, axis=0)
            across = np.column_stack((-along[:, 1], along[:, 0])) / np.hypot(*along.T)[:, np.newaxis]
            middles = (points[:-1] + points[1:]) / 2
            profile = [sample(image, middles + offset * across).mean() for offset in offsets]
            assert abs(offsets[np.argmax(profile)]) <= 0.5
            assert max(profile) > np.median(profile) + 5
            assert 0.5 < min(line["width_px"]) < max(line["width_px"]) < 6


def sample(image: NDArray[np.float32], points: NDArray[np.float64]) -> NDArray[np.float32]:
    """The image at points whose origin is the corner of the top-left pixel."""
    x, y = (points - 0.5).astype(np.float32).T
    return cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).ravel()


def test_a_seed_is_a_flight(flight: Path, tmp_path: Path) -> None:
    again, other = tmp_path / "again.mcap", tmp_path / "other.mcap"
    simulate_flight(again, OPTIONS)
    assert again.read_bytes() == flight.read_bytes()
    simulate_flight(other, SimulationOptions(seconds=0.5, fps=2, image_size=(360, 640), seed=4))
    first, second = (read(path, CompressedImage, "/camera/image")[0][1].data for path in (flight, other))
    assert first != second


def test_what_exists_is_kept(flight: Path) -> None:
    before = flight.read_bytes()
    with pytest.raises(OutputError, match="it exists already; remove it"):
        simulate_flight(flight, OPTIONS)
    assert flight.read_bytes() == before
    with pytest.raises(OutputError, match="it exists already"):
        simulate_flight(Path(), OPTIONS)
    with pytest.raises(OutputError, match="cannot be written"):
        simulate_flight(flight.parent / "no" / "demo.mcap", OPTIONS)


def test_a_camera_by_hand() -> None:
    """Straight down from 10 m with 100 px of focal length: 1 m is 10 px, x is up in the image, y left."""
    camera = look(np.array([0.0, 0.0, 10.0]), Gaze(0.0, np.pi / 2), 100.0, (200, 300))
    pixels, depths = camera.project(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 5.0]]))
    np.testing.assert_allclose(pixels, [[150, 100], [150, 90], [110, 100]], atol=1e-9)
    np.testing.assert_allclose(depths, [10, 10, 5])


def test_what_is_seen_ends_at_the_image() -> None:
    camera = look(np.array([0.0, 0.0, 30.0]), Gaze(0.0, np.pi / 2), 200.0, (200, 300))
    for conductor in hang_line(-1, 3, n_phases=3, n_bundle=1).conductors:
        (part,) = visible_parts(camera, conductor)
        assert sorted((part.pixels[0, 1], part.pixels[-1, 1])) == pytest.approx([0, 200], abs=1e-9)
        assert part.widths_px == pytest.approx(conductor.diameter_m * 200 / (30 - 11), rel=0.3)


def test_every_option_of_the_command_counts(
    tmp_path: Path, flat_ground: None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    options = "--seconds 8 --fps 1 --size 96x64 --seed 4 --flight orbit --structures 4 --phases 2 --bundle 2"
    noise = "--circuits 2 --position-noise 1 --drift 0.5 --attitude-noise 0.1"
    looks = "--corner 12 --hills 6 --wind 8 --weather haze --towers steel"
    target = tmp_path / "a.mcap"
    arguments = [
        *options.split(),
        *noise.split(),
        *looks.split(),
        "--fault",
        "blur",
        "--fault",
        "missing_conductor",
        "--schema",
        "ros2",
    ]
    monkeypatch.setattr(sys, "argv", ["lsnet-pipe", "simulate", str(target), *arguments])
    with pytest.raises(SystemExit):
        cli.main()
    assert capsys.readouterr().out == f"{target}\n{tmp_path / 'a.truth.json'}\n"
    truth = json.loads((tmp_path / "a.truth.json").read_text())
    assert truth["options"] == {
        "seconds": 8.0,
        "fps": 1.0,
        "image_size": [64, 96],
        "seed": 4,
        "flight": "orbit",
        "n_structures": 4,
        "n_phases": 2,
        "n_bundle": 2,
        "n_circuits": 2,
        "position_noise_m": 1.0,
        "drift_m": 0.5,
        "attitude_noise_deg": 0.1,
        "corner_deg": 12.0,
        "hills_m": 6.0,
        "wind_deg": 8.0,
        "weather": "haze",
        "towers": "steel",
        "faults": ["blur", "missing_conductor"],
        "schema": "ros2",
        "ground": None,
        "render": "drawn",
    }
    assert len(truth["structures"]) == 4
    assert {fault["kind"] for fault in truth["faults"]} == {"blur", "missing_conductor"}
    sharpness = {frame["quality"]: [] for frame in truth["frames"]}
    images = [frame.image for frame in iter_frames(open_recording(target))]
    for image, frame in zip(images, truth["frames"], strict=True):
        sharpness[frame["quality"]].append(measure_quality(image).sharpness)
    assert max(sharpness["blurred"]) < min(sharpness["ok"]) / 2


@pytest.mark.slow
def test_a_photograph_is_the_ground(tmp_path: Path) -> None:
    """A photograph without green: what is drawn has hardly anything else."""
    photograph, target = tmp_path / "photo.png", tmp_path / "flight.mcap"
    bgr = np.full((60, 80, 3), (200, 60, 190), np.uint8)
    cv2.imwrite(str(photograph), bgr)
    simulate_flight(target, replace(OPTIONS, ground=photograph))
    (_, first), *_ = read(target, CompressedImage, "/camera/image")
    pixels = cv2.imdecode(np.frombuffer(first.data, np.uint8), cv2.IMREAD_COLOR)
    assert np.median(pixels.reshape(-1, 3), axis=0) == pytest.approx((200, 60, 190), abs=6)
    truth = json.loads(target.with_suffix(".truth.json").read_text())
    assert truth["options"]["ground"] == "photo.png"


def test_what_is_no_photograph_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    text, target = tmp_path / "photo.png", tmp_path / "flight.mcap"
    text.write_text("no picture")
    monkeypatch.setattr(sys, "argv", ["lsnet-pipe", "simulate", str(target), "--ground", str(text)])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 1
    assert capsys.readouterr().err.startswith(f"error: {text}: cannot be read as an image")
    assert [path.name for path in tmp_path.iterdir()] == ["photo.png"]


def test_a_tile_of_a_photograph_repeats() -> None:
    tile = lay_photograph(np.random.default_rng(0).integers(0, 256, (30, 40, 3), np.uint8))
    width = simulate_ground.TILE_TEXELS[1]
    assert tile.shape == (width * 3 // 4, width, 3)
    assert np.array_equal(tile[0], tile[-1])
    assert np.array_equal(tile[:, 0], tile[:, -1])


@pytest.mark.slow
def test_traced_conductors_are_where_the_truth_says(tmp_path: Path) -> None:
    """They are bright on the true lines, beside which the picture is the drawn one."""
    pytest.importorskip("mitsuba")
    photograph = tmp_path / "grey.png"
    cv2.imwrite(str(photograph), np.full((60, 80, 3), 90, np.uint8))
    options = replace(OPTIONS, seconds=0.5, ground=photograph)
    pictures = []
    for kind in (RenderKind.PBR, RenderKind.DRAWN):
        target = tmp_path / kind / "demo.mcap"
        target.parent.mkdir()
        simulate_flight(target, replace(options, render=kind))
        ((_, image),) = read(target, CompressedImage, "/camera/image")
        pictures.append(pixels_of(image).astype(float))
    (frame,) = truth_of(tmp_path / "pbr" / "demo.mcap")
    beside, on = np.ones(pictures[0].shape, np.uint8), np.zeros(pictures[0].shape, np.uint8)
    for line in frame["lines"]:
        corners = np.rint(np.array(line["points"]) - 0.5).astype(np.int32)
        cv2.polylines(beside, [corners], False, 0, 7)
        cv2.polylines(on, [corners], False, 1, 1)
    traced, drawn = pictures
    assert np.median(traced[on == 1]) > 120  # over ground of 90
    assert (np.abs(traced - drawn) > 25)[beside == 1].mean() < 0.001
