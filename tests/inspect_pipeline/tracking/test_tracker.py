"""Tracking: lines whose motion is known, and a Kalman filter written in matrices."""

from __future__ import annotations

import json
from dataclasses import astuple
from itertools import pairwise
from typing import TYPE_CHECKING

import duckdb
import numpy as np
import pytest
from flights import START_NS, TrackedRows, flight_id_of
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from inspect_pipeline.geometry.attitude import YawPitchRoll
from inspect_pipeline.georeference.frame_pose import FramePose
from inspect_pipeline.index.flight_tables import FlightWriter
from inspect_pipeline.recording.types import Frame
from inspect_pipeline.tracking.camera_motion import CameraMotion
from inspect_pipeline.tracking.kalman import KalmanState, Transition
from inspect_pipeline.tracking.tracker import FrameInfo, LineTracker
from lsnet.segments import Detections, Lines, Segments

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

SIZE = (720, 1280)
PERIOD_NS = 200_000_000


def frame_info(i: int) -> FrameInfo:
    return FrameInfo(i, START_NS + i * PERIOD_NS, SIZE)


def across(y: float, slope_px: float = 0.0, x1: float = 0.0, x2: float = 1280.0) -> tuple[float, ...]:
    """A line from x1 to x2 that passes the middle of the image at height y."""
    return (x1, y + slope_px * (x1 / 1280 - 0.5), x2, y + slope_px * (x2 / 1280 - 0.5))


def run(frames: Sequence[Sequence[tuple[float, ...]]]) -> tuple[list[list[int]], LineTracker]:
    tracker = LineTracker()
    ids = [
        tracker.update(frame_info(i), np.array(lines).reshape(-1, 4), np.full(len(lines), 0.5)).tolist()
        for i, lines in enumerate(frames)
    ]
    return ids, tracker


def test_drifting_lines_keep_their_tracks_in_any_order() -> None:
    frames = [[across(100 + 12 * i), across(200 + 12 * i), across(300 + 12 * i)] for i in range(12)]
    ids, tracker = run([lines if i % 2 else lines[::-1] for i, lines in enumerate(frames)])
    assert all(found == (ids[1] if i % 2 else ids[0]) for i, found in enumerate(ids))
    assert ids[0] == ids[1][::-1]
    rows = tracker.finish()
    assert [(row.n_frames, row.n_coasted, row.first_frame_idx, row.last_frame_idx) for row in rows] == [
        (12, 0, 0, 11)
    ] * 3
    assert sorted(row.mean_offset_px for row in rows) == pytest.approx([-194, -94, 6], abs=15)
    assert all(min(row.mean_angle_deg, 180 - row.mean_angle_deg) < 0.5 for row in rows)
    assert {(row.start_ns, row.end_ns) for row in rows} == {(START_NS, START_NS + 11 * PERIOD_NS)}


def test_crossing_line_keeps_its_track() -> None:
    """One line moves down by 30 px a frame across two that stay."""
    frames = [[across(250), across(500), across(100 + 30 * i, slope_px=250)] for i in range(20)]
    ids, _ = run(frames)
    assert all(found == ids[0] for found in ids)


def test_track_coasts_over_missed_frames_and_counts_them() -> None:
    frames = [[across(300 + 8 * i)] if not 5 <= i < 9 else [] for i in range(15)]
    ids, tracker = run(frames)
    assert {found[0] for found in ids if found} == {ids[0][0]}
    (row,) = tracker.finish()
    assert (row.n_frames, row.n_coasted) == (11, 4)


def test_line_gets_a_new_track_after_a_long_absence() -> None:
    frames = [[across(300)] if not 5 <= i < 20 else [] for i in range(25)]
    ids, tracker = run(frames)
    assert ids[4] != ids[20]
    assert [row.n_frames for row in tracker.finish()] == [5, 5]


def test_random_clutter_makes_no_long_track() -> None:
    rng = np.random.default_rng(1)
    frames = [[across(300), tuple(rng.uniform((0, 0, 0, 0), (1280, 720, 1280, 720)))] for _ in range(40)]
    ids, tracker = run(frames)
    (row,) = [row for row in tracker.finish() if row.n_frames > 6]
    assert (row.track_id, row.n_frames) == (ids[0][0], 40)


def test_pieces_of_a_line_share_its_track() -> None:
    pieces = [across(300, 50, 0, 500), across(300, 50, 620, 1280)]
    ids, _ = run([[across(300, 50)], [across(300, 50)], [*pieces, across(340, 50)], [across(300, 50)]])
    assert ids[2] == [ids[0][0], ids[0][0], ids[2][2]]
    assert ids[2][2] != ids[0][0]


def test_angle_wraps_without_a_jump() -> None:
    """Lines have no direction: 179 degrees are next to 1 degree, with the offset of opposite sign."""
    angles = np.radians(80 + 2 * np.arange(20))
    way = np.column_stack((np.cos(angles), np.sin(angles)))
    middle = np.array([700.0, 300.0])
    ends = np.column_stack((middle - 200 * way, middle + 200 * way))
    ids, tracker = run([[tuple(chord if i % 3 else chord[[2, 3, 0, 1]])] for i, chord in enumerate(ends)])
    assert {found[0] for found in ids} == {0}
    (row,) = tracker.finish()
    assert row.mean_angle_deg == pytest.approx(99, abs=2)


def project(attitude: YawPitchRoll, rays: np.ndarray) -> np.ndarray:
    """Project directions (N, 3) in north, east, down by SciPy's rotation, with a focal length of 900 px."""
    body = Rotation.from_euler("ZYX", attitude, degrees=True).inv().apply(rays)
    return 900 * body[:, 1:] / body[:, :1] + (640, 360)


def far_rays() -> np.ndarray:
    """Return rays to both ends of five parallel lines, for a camera that looks north."""
    x = np.repeat([560.0, 600.0, 640.0, 680.0, 720.0], 2)
    y = np.tile([0.0, 720.0], 5)
    return np.column_stack((np.ones(10), (x - 640) / 900, (y - 360) / 900))


def test_camera_rotation_is_compensated() -> None:
    """The camera yaws by 4 degrees between frames: 60 px, 1.5 times the distance between the lines."""

    def follow(*, with_motion: bool) -> list[list[int]]:
        tracker, camera, ids = LineTracker(), CameraMotion(), []
        for i in range(12):
            attitude = YawPitchRoll(4.0 * (i % 2), 0.0, 0.0) if i > 3 else YawPitchRoll(0.0, 0.0, 0.0)
            motion = camera.update(attitude, frame_info(i).time_ns, 900.0 if with_motion else None, SIZE)
            chords = project(attitude, far_rays()).reshape(-1, 4)
            ids.append(tracker.update(frame_info(i), chords, np.ones(5), motion).tolist())
        return ids

    with_motion, without = follow(with_motion=True), follow(with_motion=False)
    assert all(found == [0, 1, 2, 3, 4] for found in with_motion)
    assert any(found != before for before, found in pairwise(without))


def test_motion_maps_pixels_of_distant_points() -> None:
    """The camera rotates about all axes after seconds at rest."""
    camera, rest, after = CameraMotion(), YawPitchRoll(30.0, -40.0, 3.0), YawPitchRoll(33.0, -38.0, 1.0)
    motions = [camera.update(rest, frame_info(i).time_ns, 900.0, SIZE) for i in range(5)]
    assert motions[0] is None
    assert all(motion == pytest.approx(np.eye(3), abs=1e-9) for motion in motions[1:])
    motion = camera.update(after, frame_info(5).time_ns, 900.0, SIZE)
    rays = Rotation.from_euler("ZYX", rest, degrees=True).apply(far_rays())
    moved = np.column_stack((project(rest, rays), np.ones(10))) @ motion.T
    assert moved[:, :2] / moved[:, 2:] == pytest.approx(project(after, rays), abs=1e-6)


def test_steady_rotation_is_not_compensated() -> None:
    camera = CameraMotion()
    motions = [
        camera.update(YawPitchRoll(2.0 * i, -30.0, 0.0), frame_info(i).time_ns, 900.0, SIZE) for i in range(8)
    ]
    assert all(motion == pytest.approx(np.eye(3), abs=1e-6) for motion in motions[1:])
    assert camera.update(None, frame_info(8).time_ns, 900.0, SIZE) is None
    assert (
        camera.update(YawPitchRoll(0.0, 0.0, 0.0), frame_info(9).time_ns, 900.0, SIZE) is None
    )  # starts again


def test_frames_without_lines_make_no_tracks() -> None:
    ids, tracker = run([[], [], []])
    assert (ids, tracker.finish()) == ([[], [], []], [])


@given(st.floats(0.01, 3), st.floats(0.01, 3), st.floats(-5, 5), st.floats(-5, 5))
def test_two_predictions_equal_one_over_the_sum(
    first_s: float, second_s: float, value: float, rate: float
) -> None:
    twice, once = KalmanState(value, 0.3, 2.0, rate, 0.1), KalmanState(value, 0.3, 2.0, rate, 0.1)
    twice.predict(Transition.over(first_s))
    twice.predict(Transition.over(second_s))
    once.predict(Transition.over(first_s + second_s))
    assert astuple(twice) == pytest.approx(astuple(once))


@given(st.floats(0.1, 5), st.floats(0.1, 5), st.floats(-0.9, 0.9), st.floats(0.1, 5), st.floats(-9, 9))
def test_update_equals_the_matrix_form(
    value_var: float, rate_var: float, correlation: float, noise_var: float, difference: float
) -> None:
    """Compare with x + K y and (I - K H) P."""
    cross_var = correlation * np.sqrt(value_var * rate_var)
    measured = KalmanState(1.0, value_var, 1.0, 2.0, cross_var)
    measured.rate_var = rate_var
    covariance = np.array([[value_var, cross_var], [cross_var, rate_var]])
    seen = np.array([[1.0, 0.0]])
    gain = covariance @ seen.T / (seen @ covariance @ seen.T + noise_var)
    state = np.array([[1.0], [2.0]]) + gain * difference
    covariance = (np.eye(2) - gain @ seen) @ covariance
    measured.update(difference, noise_var)
    assert (measured.value, measured.rate) == pytest.approx(tuple(state.ravel()))
    found = (measured.value_var, measured.covariance, measured.rate_var)
    assert found == pytest.approx((covariance[0, 0], covariance[0, 1], covariance[1, 1]))


def test_tracks_parquet_of_two_cameras(tmp_path: Path) -> None:
    """One camera has a line in each frame and a false one once, the other has none."""
    image = np.zeros((*SIZE, 3), np.uint8)
    place = FramePose(
        lat_deg=52.0,
        lon_deg=5.0,
        cam_yaw_deg=0.0,
        cam_pitch_deg=-30.0,
        cam_roll_deg=0.0,
        attitude_source="camera",
        focal_px=900.0,
    )
    with FlightWriter(tmp_path, flight_id_of("a")) as writer:
        rows_of_flight = TrackedRows(writer)
        for i in range(5):
            chords = [across(300), across(600, 100)] if i == 2 else [across(300)]
            points = tuple(np.array(chord, np.float32).reshape(2, 2) for chord in chords)
            lines = Lines(points, np.full(len(points), 0.5, np.float32), SIZE)
            time_ns = START_NS + i * PERIOD_NS
            for channel_id, found in ((1, lines), (2, Lines.empty(SIZE))):
                frame = Frame(channel_id, "/c", i, time_ns, time_ns, time_ns, "", image)
                rows_of_flight.add_frame(frame, Detections(Segments.empty(SIZE), found), place=place)
        rows_of_flight.finish()
    rows = duckdb.execute(
        "SELECT channel_id, track_id, first_frame_idx, last_frame_idx, n_frames, n_coasted, mean_score"
        f" FROM '{tmp_path}/tracks.parquet'"
    ).fetchall()
    assert rows == [(1, 0, 0, 4, 5, 0, 0.5)]
    lines_of = duckdb.execute(
        f"SELECT frame_idx, line_idx, track_id FROM '{tmp_path}/lines.parquet' ORDER BY ALL"
    ).fetchall()
    assert lines_of == [(0, 0, 0), (1, 0, 0), (2, 0, 0), (2, 1, None), (3, 0, 0), (4, 0, 0)]
    (placed,) = duckdb.execute(
        "SELECT DISTINCT {'lat': lat_deg, 'pitch': cam_pitch_deg, 'of': attitude_source, 'gsd': gsd_m}::JSON"
        f" FROM '{tmp_path}/frames.parquet'"
    ).fetchall()
    assert json.loads(placed[0]) == {"lat": 52.0, "pitch": -30.0, "of": "camera", "gsd": None}
