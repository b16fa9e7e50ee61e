"""Frames of recordings with their places: of a simulated flight beside its truth, and by hand."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import duckdb
import numpy as np
import pyproj
import pytest
from fakes import FakeDetector
from terrain import write_dem

from inspect_pipeline.config import PlacingOptions, ProcessOptions, start_run
from inspect_pipeline.errors import TerrainError
from inspect_pipeline.geometry.attitude import YawPitchRoll
from inspect_pipeline.geometry.camera import Intrinsics
from inspect_pipeline.geometry.terrain import load_elevation
from inspect_pipeline.georeference.calibration import LensTrack
from inspect_pipeline.georeference.frame_pose import FramePose
from inspect_pipeline.georeference.frames import Georeferencer
from inspect_pipeline.georeference.poses import PoseSamples, PoseTrack
from inspect_pipeline.pipeline import process
from inspect_pipeline.recording.types import Frame
from inspect_pipeline.simulation.options import FaultKind, SimulationOptions
from inspect_pipeline.simulation.truth import simulate_truth
from inspect_pipeline.simulation.write import simulate_flight
from inspect_pipeline.store.store import Store

if TYPE_CHECKING:
    from pathlib import Path

HERE = (52.0, 5.0, 80.0)
TIME_NS = 1_700_000_000 * 10**9
NORTH_DOWN = YawPitchRoll(0.0, -45.0, 0.0)


def at_once(*values: float) -> PoseSamples:
    return PoseSamples(np.array([TIME_NS], np.uint64), np.array([values]))


def frame(width: int = 1280) -> Frame:
    image = np.zeros((width * 9 // 16, width, 3), np.uint8)
    return Frame(1, "/camera", 0, TIME_NS + 4_000_000, TIME_NS, TIME_NS, "", image)


def placed(track: PoseTrack, *, width: int = 1280, **options: float | Path | None) -> FramePose:
    lens = Intrinsics((720, 1280), (1000.0, 1000.0), (640.0, 360.0), "", ())
    lenses = {1: LensTrack([TIME_NS], [lens])} if options.pop("with_lens", 1) else {}
    terrain = options.get("terrain")
    return Georeferencer(
        track, lenses, PlacingOptions(**options), load_elevation(terrain) if terrain else None
    ).place(frame(width))


def track(*, camera: bool = True, vehicle: bool = True, height_m: float | None = 30.0) -> PoseTrack:
    return PoseTrack(
        positions=at_once(*HERE),
        vehicle=at_once(20.0, 0.0, 0.0) if vehicle else PoseSamples(),
        camera=at_once(*NORTH_DOWN, 0) if camera else PoseSamples(),
        heights=at_once(height_m) if height_m is not None else PoseSamples(),
    )


def metres_from_here(place: FramePose) -> tuple[float, float]:
    projection = pyproj.Proj(proj="tmerc", lat_0=HERE[0], lon_0=HERE[1], ellps="WGS84")
    return projection(place.ground_lon_deg, place.ground_lat_deg)


def test_a_camera_that_looks_ahead_and_down() -> None:
    place = placed(track())
    assert (place.lat_deg, place.lon_deg, place.alt_m, place.height_m) == (*HERE, 30.0)
    assert (place.cam_yaw_deg, place.cam_pitch_deg, place.cam_roll_deg) == NORTH_DOWN
    assert (place.attitude_source, place.heading_deg, place.pose_age_ms) == ("camera", 20.0, 4.0)
    assert metres_from_here(place) == pytest.approx((0, 30), abs=1e-3)
    assert place.gsd_m == pytest.approx(30 * np.sqrt(2) / 1000)
    assert place.wire_px == pytest.approx(0.022 / place.gsd_m)


def test_altitude_above_the_ground_counts_before_what_the_recording_says() -> None:
    place = placed(track(), ground_alt_m=60.0, wire_m=0.05)
    assert place.height_m == 20.0
    assert metres_from_here(place) == pytest.approx((0, 20), abs=1e-3)
    assert place.wire_px == pytest.approx(0.05 * 1000 / (20 * np.sqrt(2)))


def test_without_a_gimbal_the_camera_looks_down_out_of_the_vehicle() -> None:
    place = placed(track(camera=False))
    assert place.attitude_source == "vehicle"
    assert (place.cam_yaw_deg, place.cam_pitch_deg, place.cam_roll_deg) == pytest.approx((20, -90, 0))
    assert metres_from_here(place) == pytest.approx((0, 0), abs=1e-3)
    assert place.gsd_m == pytest.approx(0.03)


def test_without_attitude_it_is_taken_to_look_down_and_says_so() -> None:
    place = placed(track(camera=False, vehicle=False))
    assert (place.attitude_source, place.cam_pitch_deg, place.cam_yaw_deg) == ("nadir", -90.0, None)
    assert place.gsd_m == pytest.approx(0.03)
    assert metres_from_here(place) == pytest.approx((0, 0), abs=1e-3)


def test_what_is_not_known_is_not_said() -> None:
    empty = PoseSamples()
    assert placed(PoseTrack(empty, empty, empty)) == FramePose(focal_px=1000.0)
    blind = placed(track(), with_lens=0)
    assert (blind.focal_px, blind.gsd_m, blind.wire_px) == (None, None, None)
    assert metres_from_here(blind) == pytest.approx((0, 30), abs=1e-3)
    floating = placed(track(height_m=None))
    assert (floating.height_m, floating.gsd_m, floating.ground_lat_deg) == (None, None, None)
    turned = placed(replace(track(), positions=empty))
    assert (turned.cam_pitch_deg, turned.attitude_source, turned.ground_lat_deg) == (-45.0, None, None)
    level = placed(replace(track(), camera=at_once(0.0, 3.0, 0.0, 0)))
    assert (level.cam_pitch_deg, level.gsd_m, level.ground_lat_deg) == (3.0, None, None)


def test_lenses_of_smaller_pictures_and_of_a_view() -> None:
    assert placed(track(), width=640).focal_px == 500.0
    assert placed(track(), with_lens=0, view_deg=90.0).focal_px == pytest.approx(640.0)


@pytest.fixture(scope="module")
def rows(
    tmp_path_factory: pytest.TempPathFactory, flat_ground: None
) -> tuple[SimulationOptions, list[dict[str, object]]]:
    """The frames of a simulated flight that was processed."""
    folder = tmp_path_factory.mktemp("placing")
    options = SimulationOptions(
        seconds=6, fps=2, image_size=(72, 128), seed=5, faults=(FaultKind.GPS_GAP, FaultKind.CLOCK_STEP)
    )
    simulate_flight(folder / "a.mcap", options)
    detector, store = FakeDetector(), Store(folder / "store")
    result = process(
        folder / "a.mcap", store, detector, ProcessOptions(), start_run(detector, ProcessOptions())
    )
    parquet = store.flight_dir(result.flight_id) / "frames.parquet"
    found = duckdb.execute(f"SELECT * FROM '{parquet}' ORDER BY frame_idx")
    names = [column[0] for column in found.description]
    return options, [dict(zip(names, row, strict=True)) for row in found.fetchall()]


def test_rows_of_a_flight_are_as_its_truth(
    rows: tuple[SimulationOptions, list[dict[str, object]]],
) -> None:
    options, found = rows
    frames = simulate_truth(options).frames
    names = ("lat_deg", "lon_deg", "alt_m", "height_m", "heading_deg")
    names += ("cam_yaw_deg", "cam_pitch_deg", "cam_roll_deg", "pose_age_ms", "focal_px")
    for row, frame in zip(found, frames, strict=True):
        assert row["log_time_ns"] == frame.log_time_ns
        assert row["stamp_ns"] == frame.stamp_ns
        assert [row[name] for name in names] == pytest.approx([getattr(frame, name) for name in names])
        assert row["attitude_source"] == "camera"
    ages_ms = [row["pose_age_ms"] for row in found]
    assert max(ages_ms) >= 1000  # the gap of positions
    assert len({row["stamp_ns"] - row["log_time_ns"] for row in found}) == 2  # the step of the clock


def test_the_ground_is_where_the_truth_would_have_it(
    rows: tuple[SimulationOptions, list[dict[str, object]]],
) -> None:
    """The distance to it, by the sine of the pitch; the direction, by that of the camera."""
    earth = pyproj.Geod(ellps="WGS84")
    for row in rows[1]:
        azimuth_deg, _, distance_m = earth.inv(
            row["lon_deg"], row["lat_deg"], row["ground_lon_deg"], row["ground_lat_deg"]
        )
        down = np.radians(-row["cam_pitch_deg"])
        assert distance_m == pytest.approx(row["height_m"] / np.tan(down), abs=1e-3)
        assert np.cos(np.radians(azimuth_deg - row["cam_yaw_deg"])) == pytest.approx(1)
        assert row["gsd_m"] == pytest.approx(row["height_m"] / np.sin(down) / row["focal_px"])


def test_ground_rises_as_the_terrain_does(tmp_path: Path) -> None:
    """Ground that rises by a quarter to the north, seen at 45 degrees from 30 m: met 24 m ahead, 6 m up."""
    dem = write_dem(tmp_path / "dem.tif", HERE[:2], lambda _, north: 1000 + 0.25 * north)
    place = placed(track(), terrain=dem)
    assert place.height_m == pytest.approx(30, abs=0.1)
    assert metres_from_here(place) == pytest.approx((0, 24), abs=0.1)
    assert place.gsd_m == pytest.approx(24 * np.sqrt(2) / 1000, rel=0.01)


def test_heights_count_from_where_the_recording_begins(tmp_path: Path) -> None:
    """100 m to the north, the ground of the same slope is 25 m higher."""
    dem = write_dem(tmp_path / "dem.tif", HERE[:2], lambda _, north: 1000 + 0.25 * north)
    north_lat_deg = HERE[0] + 100 / 111_258
    flown = PoseSamples(
        np.array([TIME_NS, TIME_NS + 10**6], np.uint64), np.array([HERE, (north_lat_deg, HERE[1], 80.0)])
    )
    place = placed(replace(track(), positions=flown), terrain=dem)
    assert place.height_m == pytest.approx(5, abs=0.2)
    assert place.rise_m == pytest.approx(25, abs=0.2)
    assert placed(replace(track(), positions=flown)).rise_m is None


def test_beside_the_terrain_nothing_is_known(tmp_path: Path) -> None:
    dem = write_dem(tmp_path / "dem.tif", HERE[:2], lambda east, _: np.where(east > -100, np.nan, 7.0))
    place = placed(track(), terrain=dem)
    assert (place.lat_deg, place.height_m, place.gsd_m) == (HERE[0], None, None)


def test_what_is_no_terrain_model(tmp_path: Path) -> None:
    pytest.importorskip("rasterio")
    text = tmp_path / "dem.tif"
    text.write_text("no heights")
    with pytest.raises(TerrainError, match="cannot be read as a terrain model"):
        start_run(FakeDetector(), ProcessOptions(placing=PlacingOptions(terrain=text)))
    local = write_dem(tmp_path / "local.tif", HERE[:2], lambda east, _: east, crs='LOCAL_CS["site"]')
    with pytest.raises(TerrainError, match="cannot be read as a terrain model"):
        load_elevation(local)


def test_the_content_of_a_terrain_model_is_part_of_the_config(tmp_path: Path) -> None:
    def digest(path: Path | None) -> str:
        return start_run(FakeDetector(), ProcessOptions(placing=PlacingOptions(terrain=path))).config_sha256

    first = write_dem(tmp_path / "a.tif", HERE[:2], lambda _, north: 0.1 * north)
    other = write_dem(tmp_path / "b.tif", HERE[:2], lambda _, north: 0.2 * north)
    before = digest(first)
    assert len({before, digest(other), digest(None)}) == 3
    assert digest(first.rename(tmp_path / "c.tif")) == before


def test_the_lens_is_the_one_in_force_at_the_time() -> None:
    near = Intrinsics((720, 1280), (1000.0, 1000.0), (640.0, 360.0), "", ())
    far = replace(near, focal_px=(4000.0, 4000.0))
    lens = LensTrack()
    for after_ms, one in ((3, near), (3.5, near), (5, far)):
        lens.add(TIME_NS + round(after_ms * 1e6), one)
    place = Georeferencer(track(), {1: lens}, PlacingOptions()).place
    focal_px = [
        place(replace(frame(), log_time_ns=TIME_NS + after_ms * 1_000_000)).focal_px
        for after_ms in (0, 4, 5, 9)
    ]
    assert focal_px == [1000.0, 1000.0, 4000.0, 4000.0]
    assert len(lens.lenses) == 2
