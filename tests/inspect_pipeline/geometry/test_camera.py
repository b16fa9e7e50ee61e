"""Rays and where they meet the world: by hand, against trigonometry and OpenCV, and there and back."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from inspect_pipeline.geometry import camera as geo
from inspect_pipeline.geometry.attitude import YawPitchRoll
from inspect_pipeline.geometry.camera import Intrinsics
from inspect_pipeline.geometry.terrain import meet_ground

LENS = Intrinsics((720, 1280), (1000.0, 1000.0), (640.0, 360.0), "", ())
TURNS = st.builds(YawPitchRoll, st.floats(-180, 180), st.floats(-89.9, 89.9), st.floats(-179, 179))
MIDDLE = (640.0, 360.0)


def test_a_camera_by_hand() -> None:
    """It looks north, 45 degrees down, from 50 m: the middle of the image is on the ground 50 m ahead."""
    turns = YawPitchRoll(0.0, -45.0, 0.0)
    rays = geo.pixel_rays(LENS, turns, [MIDDLE, (1640.0, 360.0), (640.0, 1360.0), (640.0, -1640.0)])
    met = meet_ground(rays, 50.0)
    np.testing.assert_allclose(met[0], (0, 50, -50), atol=1e-9)
    np.testing.assert_allclose(met[1], (50 * np.sqrt(2), 50, -50), atol=1e-9)  # 45 degrees to the right
    np.testing.assert_allclose(met[2], (0, 0, -50), atol=1e-9)  # 45 degrees further down
    assert np.isnan(met[3]).all()  # above the horizon


@given(TURNS)
def test_axes_agree_with_trigonometry(turns: YawPitchRoll) -> None:
    yaw, pitch, roll = np.radians(turns)
    level = np.array([np.cos(yaw), -np.sin(yaw), 0])  # to the right, without roll
    ahead = np.array([np.sin(yaw) * np.cos(pitch), np.cos(yaw) * np.cos(pitch), np.sin(pitch)])
    below = np.cross(ahead, level)
    right, down = np.cos(roll) * level + np.sin(roll) * below, np.cos(roll) * below - np.sin(roll) * level
    np.testing.assert_allclose(geo.camera_axes(turns), (right, down, ahead), atol=1e-12)


def test_axes_of_many_frames_are_those_of_each_and_unknown_where_a_turn_is() -> None:
    turns = np.random.default_rng(0).uniform(-180, 180, (2, 5, 3))
    axes = geo.camera_axes(turns)
    assert axes.shape == (2, 5, 3, 3)
    np.testing.assert_allclose(axes[1, 3], geo.camera_axes(turns[1, 3]))
    assert np.isnan(geo.camera_axes([(np.nan, 0.0, 0.0), (0.0, 0.0, 0.0)])).any(axis=(1, 2)).tolist() == [
        True,
        False,
    ]


@given(TURNS, st.floats(0, 1280), st.floats(0, 720), st.floats(1, 500))
def test_what_is_met_on_the_ground_is_seen_at_its_pixel(
    turns: YawPitchRoll, x: float, y: float, height_m: float
) -> None:
    met = meet_ground(geo.pixel_rays(LENS, turns, (x, y)), height_m)[0]
    if not np.isnan(met).any() and np.linalg.norm(met) < 1e6:
        assert project(turns, met) == pytest.approx((x, y), abs=1e-5)
        assert met[2] == pytest.approx(-height_m)


def project(turns: YawPitchRoll, place: np.ndarray) -> tuple[float, float]:
    """The pixel of a place (east, north, up) by OpenCV."""
    ned_to_camera = np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]]) @ np.linalg.inv(
        Rotation.from_euler("ZYX", turns, degrees=True).as_matrix()
    )
    ned = np.array([place[1], place[0], -place[2]])
    rotation, _ = cv2.Rodrigues(ned_to_camera)
    lens = np.array([[1000, 0, 640], [0, 1000, 360], [0, 0, 1]], np.float64)
    pixels, _ = cv2.projectPoints(ned[np.newaxis], rotation, np.zeros(3), lens, None)
    return tuple(pixels.ravel())


def test_distortion_is_undone() -> None:
    lens = Intrinsics(
        (720, 1280), (900.0, 910.0), (630.0, 370.0), "plumb_bob", (-0.2, 0.05, 1e-3, -1e-3, 0.0)
    )
    seen = np.array([[-0.4, -0.2, 1.0], [0.0, 0.0, 1.0], [0.5, 0.25, 1.0]])
    matrix = np.array([[900, 0, 630], [0, 910, 370], [0, 0, 1]], np.float64)
    pixels, _ = cv2.projectPoints(seen, np.zeros(3), np.zeros(3), matrix, np.array(lens.distortion))
    rays = geo.pixel_rays(lens, YawPitchRoll(0.0, 0.0, 0.0), pixels.reshape(-1, 2))
    np.testing.assert_allclose(rays[:, [0, 2]] / rays[:, 1:2], seen[:, :2] * (1, -1), atol=1e-4)


@given(TURNS)
def test_a_camera_mounted_downwards_sees_what_is_below_the_vehicle(turns: YawPitchRoll) -> None:
    right, down, ahead = geo.camera_axes(turns)
    found = geo.camera_axes(geo.turned_down(turns))
    np.testing.assert_allclose(found, (right, -ahead, down), atol=1e-5)


def test_a_level_vehicle_looks_straight_down_its_heading_up() -> None:
    assert geo.turned_down(YawPitchRoll(70.0, 0.0, 0.0)) == pytest.approx((70.0, -90.0, 0.0))


def test_the_table_of_errors_is_what_the_functions_say() -> None:
    """The table of docs/inspection.md: shift of the ground point at the image centre from 50 m."""
    text = (Path(__file__).parents[3] / "docs" / "inspection.md").read_text(encoding="utf-8")
    _, _, *rows = re.search(r"\| pitch \|.*?\n\n", text, re.DOTALL).group().strip().splitlines()

    def place(pitch_deg: float, yaw_deg: float = 0.0, height_m: float = 50.0) -> np.ndarray:
        return meet_ground(geo.pixel_rays(LENS, YawPitchRoll(yaw_deg, pitch_deg, 0.0), MIDDLE), height_m)[
            0, :2
        ]

    assert len(rows) == 4
    for row in rows:
        pitch_deg, *documented = (
            float(cell.strip().removesuffix(" m")) for cell in row.strip("|").split("|")
        )
        shifted = [place(pitch_deg + error) for error in (0.5, 1, 2)]
        shifted += [place(pitch_deg, yaw_deg=1), place(pitch_deg, height_m=51)]
        found = [np.linalg.norm(there - place(pitch_deg)) for there in shifted]
        assert found == pytest.approx(documented, abs=0.0051)


@pytest.mark.parametrize("n_coefficients", [1, 3, 6])
def test_distortion_of_as_many_coefficients_as_no_model_has_is_none(n_coefficients: int) -> None:
    lens = replace(LENS, distortion_model="plumb_bob", distortion=(0.1,) * n_coefficients)
    turns = YawPitchRoll(10.0, -40.0, 0.0)
    np.testing.assert_array_equal(geo.pixel_rays(lens, turns, (0, 0)), geo.pixel_rays(LENS, turns, (0, 0)))


def test_lenses_of_a_view_and_of_smaller_pictures() -> None:
    lens = geo.lens_of_view((720, 1280), 90.0)
    assert lens.focal_px == pytest.approx((640.0, 640.0))
    smaller = geo.resized(LENS, (360, 640))
    assert (smaller.focal_px, smaller.centre_px) == ((500.0, 500.0), (320.0, 180.0))
