"""Corners, hills and wind by other formulas: azimuths, rasterio, and wire ends projected by angles."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import pyproj
import pytest
import rasterio
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

import cli
from inspect_pipeline.errors import OutputError
from inspect_pipeline.simulation.ground import TEXEL_M
from inspect_pipeline.simulation.hills import draw_hills
from inspect_pipeline.simulation.options import LINE_FAULTS, FaultKind, FlightKind, SimulationOptions
from inspect_pipeline.simulation.power_line import hang_line
from inspect_pipeline.simulation.route import Route
from inspect_pipeline.simulation.scene import Gaze, look
from inspect_pipeline.simulation.terrain_file import write_terrain
from inspect_pipeline.simulation.truth import simulate_truth

if TYPE_CHECKING:
    from pathlib import Path

    from inspect_pipeline.simulation.records import FlightTruth, FrameTruth

FLIGHT = SimulationOptions(seconds=40, fps=1, seed=5, corner_deg=30, hills_m=9)
EARTH = pyproj.Geod(ellps="WGS84")
HALF_ARM_M, PHASE_M, RAISED_M, NEUTRAL_M = 1.6, 12.3, 12.9, (0.35, 9.2)  # of one circuit of three phases


def azimuths(truth: FlightTruth) -> np.ndarray:
    """Of each span, by geodesics between its structures."""
    places = [(one.lon_deg, one.lat_deg) for one in truth.structures]
    return np.array([EARTH.inv(*a, *b)[0] for a, b in pairwise(places)])


def test_the_line_turns_once_by_its_corner_and_the_drone_with_it() -> None:
    truth = simulate_truth(FLIGHT)
    turns = (np.diff(azimuths(truth)) + 180) % 360 - 180
    (corner,) = np.flatnonzero(np.abs(turns) > 0.01)
    assert turns[corner] == pytest.approx(-30, abs=0.01)  # to the left
    headings = np.array([frame.heading_deg for frame in truth.frames])
    assert (headings[-1] - headings[0] + 180) % 360 - 180 == pytest.approx(-30, abs=0.01)
    assert truth.spans_seen[0].span_id != truth.spans_seen[-1].span_id
    seen = [truth.span_coverage[span.span_id] for span in truth.spans]
    assert seen[corner] == seen[corner + 1] == 1  # before and after the corner


@pytest.mark.parametrize("n_structures", [3, 4, 8])
def test_a_line_that_ends_turns_at_a_structure_within_it(n_structures: int) -> None:
    turns = np.diff(azimuths(simulate_truth(replace(FLIGHT, n_structures=n_structures))))
    assert np.abs((turns + 180) % 360 - 180).max() == pytest.approx(30, abs=0.01)


@pytest.mark.parametrize("corner_rad", [0.0, 0.5, -1.0])
def test_places_beside_a_line_are_as_far_along_it_as_those_on_it(corner_rad: float) -> None:
    route, along = Route(corner_m=110, corner_rad=corner_rad), np.array([-60.0, 20.0, 90.0, 140.0, 500.0])
    places = route.places(along)
    left = [route.arm(metres) for metres in along]
    for away_m in (-7, 0, 7):
        assert route.along(places + away_m * np.array(left)) == pytest.approx(along, abs=1e-9)


@pytest.mark.parametrize("flight", list(FlightKind))
def test_the_drone_keeps_its_height_above_hills(flight: FlightKind, tmp_path: Path) -> None:
    options = replace(FLIGHT, flight=flight)
    truth, path = simulate_truth(options), tmp_path / "hills.asc"
    write_terrain(path, options)
    with rasterio.open(path) as model:
        assert model.crs.to_epsg() == 4326

        def ground_m(places: list) -> np.ndarray:
            return np.array([height[0] for height in model.sample([(p.lon_deg, p.lat_deg) for p in places])])

        feet_m = np.array([one.alt_m for one in truth.structures])
        assert ground_m(truth.structures) == pytest.approx(feet_m, abs=0.4)  # of the cell, 4 m wide
        assert np.ptp(feet_m) == pytest.approx(9, abs=0.2)  # from a ridge to about a valley
        above_m = np.array([frame.alt_m for frame in truth.frames]) - ground_m(truth.frames)
        rises_m = ground_m(truth.frames) - ground_m(truth.frames[:1])
    heights_m = [frame.height_m - frame.ground_m for frame in truth.frames]
    assert above_m == pytest.approx(heights_m, abs=0.8)  # both by the cell below the drone
    assert rises_m == pytest.approx([frame.ground_m for frame in truth.frames], abs=0.8)
    if flight != FlightKind.ORBIT:  # which keeps its height above the structure
        assert above_m == pytest.approx(23, abs=1)


def test_the_terrain_of_a_line_that_is_too_long_is_refused_before_the_flight(tmp_path: Path) -> None:
    target, terrain = tmp_path / "long.mcap", tmp_path / "long.asc"
    result = CliRunner().invoke(
        cli.app, ["simulate", str(target), "--structures", "1000", "--terrain", str(terrain)]
    )
    assert isinstance(result.exception, OutputError)
    assert str(result.exception).startswith(f"{terrain}: the line is so long")
    assert list(tmp_path.iterdir()) == []


def camera_points(frame: FrameTruth, points: np.ndarray) -> np.ndarray:
    """Pixels of points (N, 3) in metres east, north, up of the camera, by its angles one after the other."""
    turned = Rotation.from_euler("z", frame.cam_yaw_deg, degrees=True).apply(points)
    ahead, right, up = turned[:, 1], turned[:, 0], turned[:, 2]
    tilted = Rotation.from_euler("x", -frame.cam_pitch_deg, degrees=True).apply(
        np.column_stack((right, ahead, up))
    )
    height, width = frame.image_size
    scale = frame.focal_px / tilted[:, 1]
    return np.column_stack((width / 2 + scale * tilted[:, 0], height / 2 - scale * tilted[:, 2]))


def attachments(truth: FlightTruth, number: int) -> dict[str, np.ndarray]:
    """Longitude, latitude and altitude of where conductors are attached to a structure within the line."""
    foot, azimuth = truth.structures[number], azimuths(truth)
    into, out = azimuth[number - 1], azimuth[number]
    half_deg = ((out - into + 180) % 360 - 180) / 2
    along_deg, wider = into + half_deg, 1 / np.cos(np.deg2rad(half_deg))
    found = {}
    for name, left_m, up_m in (
        ("L1", -HALF_ARM_M, PHASE_M),
        ("L2", 0.0, RAISED_M),
        ("L3", HALF_ARM_M, PHASE_M),
        ("N", *NEUTRAL_M),
    ):
        lon_deg, lat_deg, _ = EARTH.fwd(foot.lon_deg, foot.lat_deg, along_deg - 90, left_m * wider)
        found[name] = np.array([lon_deg, lat_deg, foot.alt_m + up_m])
    return found


def test_lines_pass_through_the_attachments_projected_by_another_formula() -> None:
    """Structures and poses in degrees, as the truth has them, are projected by azimuths and turns."""
    truth = simulate_truth(FLIGHT)
    n_checked = 0
    for number in range(1, len(truth.structures) - 1):
        for frame in truth.frames:
            for name, (lon_deg, lat_deg, alt_m) in attachments(truth, number).items():
                azimuth_deg, _, away_m = EARTH.inv(frame.lon_deg, frame.lat_deg, lon_deg, lat_deg)
                east, north = np.sin(np.deg2rad(azimuth_deg)), np.cos(np.deg2rad(azimuth_deg))
                point = np.array([[away_m * east, away_m * north, alt_m - frame.alt_m]])
                (pixel,) = camera_points(frame, point)
                height, width = frame.image_size
                own = [line.points for line in frame.lines if line.conductor_id == name]
                if away_m < 50 and (pixel > 20).all() and (pixel < (width - 20, height - 20)).all() and own:
                    assert min(off_px(pixel, line) for line in own) < 0.8
                    n_checked += 1
    assert n_checked > 25


def off_px(point: np.ndarray, line: np.ndarray) -> float:
    """The distance of a point from a polyline (N, 2)."""
    begin, step = line[:-1], np.diff(line, axis=0)
    share = np.clip(((point - begin) * step).sum(axis=1) / (step**2).sum(axis=1), 0, 1)
    return float(np.hypot(*(begin + share[:, np.newaxis] * step - point).T).min())


def test_wires_are_straight_from_above_and_sag_below_their_ends() -> None:
    route = Route(corner_m=110, corner_rad=0.5, hills_m=9)
    still, blown = (hang_line(-1, 6, 3, 2, 1, wind, route) for wind in (0.0, 0.2))
    numbers = still.span_numbers(still.along)
    for wire, swung in zip(still.conductors, blown.conductors, strict=True):
        for span in range(5):
            points, other = wire.points[numbers == span], swung.points[numbers == span]
            share = np.linspace(0, 1, 221)[: len(points), np.newaxis]
            end = wire.points[np.searchsorted(numbers, span + 1) if span < 4 else -1]
            chord = points[0] + share * (end - points[0])
            assert np.abs(points[:, :2] - chord[:, :2]).max() < 1e-9
            assert (chord - points)[:, 2].max() == pytest.approx(1.1, abs=1e-4)
            away = np.linalg.norm(other - chord, axis=1)
            assert away == pytest.approx((chord - points)[:, 2], abs=1e-9)  # swung out, not stretched
            assert np.rad2deg(np.arcsin(np.hypot(*(other - chord)[110, :2]) / away[110])) == pytest.approx(
                np.rad2deg(0.2)
            )


def test_a_spot_on_the_ground_of_hills_is_drawn_where_it_lies() -> None:
    tile = np.zeros((1024, 4096, 3), np.uint8)
    route, spot = Route(hills_m=9), np.array([80.0, 4.0])
    row, column = (spot[::-1] / TEXEL_M).astype(int)
    tile[row - 6 : row + 6, column - 6 : column + 6] = 255
    camera = look(np.array([60.0, -5.0, 28.0]), Gaze(0.3, 0.9, 0.1), 600.0, (480, 640))
    y, x = np.nonzero(draw_hills(tile, camera, route)[..., 0] > 128)
    wanted = camera.project(np.array([[*spot, 9 / 2 * (1 - np.cos(2 * np.pi * 80 / 220))]]))[0][0]
    assert (x.mean() + 0.5, y.mean() + 0.5) == pytest.approx(tuple(wanted), abs=0.5)


@pytest.mark.parametrize("kind", LINE_FAULTS)
@pytest.mark.parametrize("flight", [FlightKind.HOVER, FlightKind.ORBIT])
def test_a_fault_is_planted_where_a_drone_that_stays_sees_it(kind: FaultKind, flight: FlightKind) -> None:
    """It shows a part of a span; a fault anywhere in the middle of that span would often be missed."""
    for seed in range(4):
        options = replace(FLIGHT, seconds=20, fps=0.5, seed=seed, flight=flight, faults=(kind,))
        assert [fault.kind for fault in simulate_truth(options).faults] == [kind]
