"""The truth of simulated flights: that faults are what they are called, and that it stands alone."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pyproj
import pytest
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_typestore

from inspect_pipeline.georeference.calibration import LensReader
from inspect_pipeline.georeference.poses import read_poses
from inspect_pipeline.recording.reader import open_recording
from inspect_pipeline.simulation.options import FaultKind, FlightKind, SchemaKind, SimulationOptions
from inspect_pipeline.simulation.truth import simulate_truth
from inspect_pipeline.simulation.write import simulate_flight

if TYPE_CHECKING:
    from inspect_pipeline.simulation.records import FaultTruth, FlightTruth, FrameTruth

DOCS = Path(__file__).parents[3] / "docs"
FLIGHT = SimulationOptions(seconds=40, fps=2, seed=2)
ALL_IN_SIGHT = {"L1", "L2", "L3", "N"}


@cache
def fly(*faults: FaultKind, **options: object) -> FlightTruth:
    return simulate_truth(replace(FLIGHT, faults=faults, **options))


def fault_of(truth: FlightTruth) -> FaultTruth:
    (fault,) = truth.faults
    return fault


def during(truth: FlightTruth, fault: FaultTruth) -> list[FrameTruth]:
    return [f for f in truth.frames if not f.dropped and fault.start_ns <= f.log_time_ns <= fault.end_ns]


def ids(frame: FrameTruth) -> set[str]:
    return {line.conductor_id for line in frame.lines}


def test_a_clean_flight_shows_all_conductors_all_the_time() -> None:
    truth = fly()
    assert len(truth.frames) == 80
    assert all(sorted(line.conductor_id for line in f.lines) == sorted(ALL_IN_SIGHT) for f in truth.frames)
    assert truth.faults == ()
    assert {span.expected_conductors for span in truth.spans} == {4}
    assert all(f.frame_idx == i for i, f in enumerate(truth.frames))
    assert {f.stamp_ns - f.log_time_ns for f in truth.frames} == {0}


def test_structures_stand_where_the_spans_say() -> None:
    truth = fly()
    earth, places = pyproj.Geod(ellps="WGS84"), {s.structure_id: s for s in truth.structures}
    azimuths = []
    for span in truth.spans:
        first, second = (places[structure_id] for structure_id in span.structure_ids)
        azimuth_deg, _, length_m = earth.inv(first.lon_deg, first.lat_deg, second.lon_deg, second.lat_deg)
        assert length_m == pytest.approx(span.length_m, abs=0.01)
        azimuths.append(azimuth_deg)
    assert np.ptp(azimuths) < 0.01


def test_the_drone_flies_along_the_line_at_its_speed() -> None:
    truth = fly()
    earth, first, last = pyproj.Geod(ellps="WGS84"), truth.frames[0], truth.frames[-1]
    azimuth_deg, _, flown_m = earth.inv(first.lon_deg, first.lat_deg, last.lon_deg, last.lat_deg)
    seconds = (last.log_time_ns - first.log_time_ns) / 1e9
    assert flown_m == pytest.approx(5 * seconds, abs=1.5)  # it sways
    assert np.cos(np.radians(azimuth_deg - first.heading_deg)) > 0.999


def test_a_missing_conductor_is_not_seen_in_its_span() -> None:
    truth = fly(FaultKind.MISSING_CONDUCTOR)
    fault = fault_of(truth)
    (name,) = fault.conductor_ids
    inside = [f for f in during(truth, fault) if [v.span_id for v in f.views] == [fault.span_id]]
    assert len(inside) > 10
    assert all(ids(f) == ALL_IN_SIGHT - {name} for f in inside)
    outside = [f for f in truth.frames if fault.span_id not in {v.span_id for v in f.views}]
    assert all(ids(f) == ALL_IN_SIGHT for f in outside)


def test_a_broken_conductor_ends_in_its_span_and_a_gap_has_two_ends() -> None:
    broken, gap = fly(FaultKind.BROKEN_CONDUCTOR), fly(FaultKind.CONDUCTOR_GAP)
    (name,) = fault_of(broken).conductor_ids
    assert any(name not in ids(f) for f in during(broken, fault_of(broken)))
    (name,) = fault_of(gap).conductor_ids
    middle = during(gap, fault_of(gap))[len(during(gap, fault_of(gap))) // 2]
    near, far = (line.points for line in middle.lines if line.conductor_id == name)
    between = min(np.hypot(*(a - b)) for a in near[[0, -1]] for b in far[[0, -1]])
    assert 60 < between < 500
    assert fault_of(gap).end_ns - fault_of(gap).start_ns > 10**9


@pytest.mark.parametrize("kind", [FaultKind.SAG_OUTLIER, FaultKind.CONDUCTORS_TOO_CLOSE])
def test_a_conductor_that_hangs_otherwise_is_elsewhere_in_the_picture(kind: FaultKind) -> None:
    truth, clean = fly(kind), fly()
    fault = fault_of(truth)
    name = fault.conductor_ids[0]
    for frame, usual in zip(truth.frames, clean.frames, strict=True):
        moved_px = max(
            np.abs(a.points[[0, -1]] - b.points[[0, -1]]).max()
            for a, b in zip(frame.lines, usual.lines, strict=True)
            if a.conductor_id == name
        )
        if fault.start_ns <= frame.log_time_ns <= fault.end_ns:
            assert moved_px > 20
        if fault.span_id not in {view.span_id for view in frame.views}:
            assert moved_px < 0.01


def test_a_crossing_line_crosses() -> None:
    truth = fly(FaultKind.CROSSING_LINE)
    fault = fault_of(truth)
    for frame in during(truth, fault):
        angles = {
            line.conductor_id: np.degrees(np.arctan2(*(line.points[-1] - line.points[0])[::-1])) % 180
            for line in frame.lines
        }
        turn = abs((angles["X1"] - angles["L2"] + 90) % 180 - 90)
        assert turn > 25
    assert not any("X1" in ids(f) for f in truth.frames if f.log_time_ns < fault.start_ns - 10**9)


@pytest.mark.parametrize(
    ("kind", "quality"),
    [(FaultKind.BLUR, "blurred"), (FaultKind.DARK, "dark"), (FaultKind.OVEREXPOSED, "overexposed")],
)
def test_spoiled_frames(kind: FaultKind, quality: str) -> None:
    truth = fly(kind)
    assert {f.quality for f in during(truth, fault_of(truth))} == {quality}
    rest = [f for f in truth.frames if f not in during(truth, fault_of(truth))]
    assert {f.quality for f in rest} == {"ok"}


def test_a_dropout_leaves_frames_out() -> None:
    truth = fly(FaultKind.DROPOUT)
    fault, dropped = fault_of(truth), [f for f in truth.frames if f.dropped]
    assert len(dropped) >= 4
    assert all(fault.start_ns < f.log_time_ns < fault.end_ns for f in dropped)
    assert [f.frame_idx for f in truth.frames if not f.dropped] == list(range(80 - len(dropped)))
    assert len(during(truth, fault)) == 2


def test_a_gap_of_positions_ages_the_pose() -> None:
    truth = fly(FaultKind.GPS_GAP)
    fault = fault_of(truth)
    stale = [f for f in truth.frames if f.pose_age_ms > 100]
    assert len(stale) >= 4
    assert all(fault.start_ns < f.log_time_ns < fault.end_ns for f in stale)
    assert len({f.lat_deg for f in stale}) == 1


def test_a_step_of_the_clock_and_a_slip_of_the_camera_last() -> None:
    stepped = fly(FaultKind.CLOCK_STEP)
    fault = fault_of(stepped)
    lags = [f.stamp_ns - f.log_time_ns for f in stepped.frames]
    assert {lag for f, lag in zip(stepped.frames, lags, strict=True) if f.log_time_ns <= fault.start_ns} == {
        0
    }
    assert abs(lags[-1]) > 5e8
    assert fault.end_ns - fault.start_ns == 500_000_000
    slipped, clean = fly(FaultKind.ORIENTATION_JUMP), fly()
    fault = fault_of(slipped)
    for frame, usual in zip(slipped.frames, clean.frames, strict=True):
        same = all(np.array_equal(a.points, b.points) for a, b in zip(frame.lines, usual.lines, strict=False))
        assert same == (frame.log_time_ns <= fault.start_ns)
        assert frame.cam_roll_deg == 0


def test_what_is_seen_of_spans() -> None:
    """The share of a span that is seen is what its views add up to; a flight that turns away sees less."""
    truth, lost = fly(), fly(flight=FlightKind.LOSS)
    for span in truth.spans:
        seen = np.zeros(int(span.length_m / 0.1), bool)
        for frame in truth.frames:
            for view in frame.views:
                if view.span_id == span.span_id:
                    seen[int(view.from_m / 0.1) : int(view.to_m / 0.1) + 1] = True
                    assert 0.005 < view.nearest_gsd_m <= view.farthest_gsd_m < 0.04
        assert truth.span_coverage[span.span_id] == pytest.approx(seen.mean(), abs=0.01)
    assert truth.span_coverage["S03-S04"] == 1
    assert min(lost.span_coverage[name] for name in ("S03-S04", "S04-S05")) < 0.7
    assert any(not f.lines for f in lost.frames)
    assert {i.span_id for i in truth.spans_seen} == {k for k, v in truth.span_coverage.items() if v}


@pytest.mark.parametrize("flight", list(FlightKind))
def test_every_kind_of_flight_shows_the_line(flight: FlightKind) -> None:
    truth = fly(flight=flight, n_phases=2, n_bundle=2)
    assert {c for f in truth.frames for c in ids(f)} == {"L1a", "L1b", "L2a", "L2b", "N"}
    assert np.mean([len(f.lines) >= 3 for f in truth.frames]) > 0.7


def test_a_line_may_end() -> None:
    truth = fly(n_structures=3)
    assert [s.structure_id for s in truth.structures] == ["S01", "S02", "S03"]
    assert truth.frames[0].lines
    assert not truth.frames[-1].lines
    with pytest.raises(ValueError, match="at least two structures"):
        fly(n_structures=1)


def test_the_example_of_the_documentation(capsys: pytest.CaptureFixture[str]) -> None:
    text = (DOCS / "inspection.md").read_text(encoding="utf-8")
    simulator = text.split("## Simulator")[1].split("## Tracks")[0]
    (source,) = re.findall(r"```python\n(.*?)```", simulator, re.DOTALL)
    exec(compile(source, "inspection.md", "exec"), {})  # noqa: S102 - our own text
    kind, _, n_lines = capsys.readouterr().out.split()
    assert (kind, n_lines) == ("missing_conductor", "4")
    assert all(f"`{kind}`" in simulator for kind in (*FaultKind, *FlightKind))


def test_the_truth_shares_no_code_with_what_it_judges() -> None:
    program = (
        "import sys\nfrom inspect_pipeline.simulation.truth import simulate_truth\n"
        "print([n for n in ('geometry', 'messages', 'georeference', 'inspection', 'tracking')"
        " if f'inspect_pipeline.{n}' in sys.modules])"
    )
    child = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert child.stdout == "[]\n"


def test_ros2_messages_are_those_of_ros2(tmp_path: Path, flat_ground: None) -> None:
    """Every message is read by rosbags, by the definitions in the file, and says what the truth says."""
    options = SimulationOptions(seconds=1, fps=2, image_size=(72, 128), schema=SchemaKind.ROS2)
    path = tmp_path / "a.mcap"
    truth = json.loads(simulate_flight(path, options).read_text())
    store, found = get_typestore(Stores.ROS2_HUMBLE), {}
    with path.open("rb") as file:
        reader = make_reader(file)
        assert reader.get_header().profile == "ros2"
        for schema, channel, message in reader.iter_messages():
            found.setdefault(channel.topic, []).append(store.deserialize_cdr(message.data, schema.name))
            assert schema.data.startswith(b"std_msgs/Header header\n")
    assert {topic: len(messages) for topic, messages in found.items()} == {
        "/camera/image/compressed": 2,
        "/camera/camera_info": 2,
        "/drone/fix": 6,
        "/drone/pose": 6,
        "/camera/pose": 6,
    }
    info, fix = found["/camera/camera_info"][0], found["/drone/fix"][0]
    assert (info.height, info.width, info.k[2], info.k[5]) == (72, 128, 63.5, 35.5)
    assert (fix.latitude, fix.longitude) == (truth["frames"][0]["lat_deg"], truth["frames"][0]["lon_deg"])
    recording = open_recording(path)
    (camera,) = recording.camera_channels
    assert camera.topic == truth["image_topic"]
    lenses = LensReader(recording)
    pose = read_poses(recording, lenses).at(truth["frames"][1]["log_time_ns"])
    focal_px = lenses.lenses()[camera.channel_id].lenses[0].focal_px
    assert focal_px == pytest.approx([truth["frames"][0]["focal_px"]] * 2)
    section = (DOCS / "formats.md").read_text(encoding="utf-8").split("## Simulated recordings")[1]
    parts = [truth, truth["frames"][0], *(truth[name][0] for name in ("structures", "spans", "spans_seen"))]
    parts += [truth["frames"][0]["lines"][0], truth["frames"][0]["views"][0]]
    assert [n for part in parts for n in part if not re.search(rf"[`.]{n}\b", section)] == []
    wanted = [
        truth["frames"][1][name] for name in ("height_m", "cam_yaw_deg", "cam_pitch_deg", "heading_deg")
    ]
    assert [pose.height_m, pose.yaw_deg, pose.pitch_deg, pose.heading_deg] == pytest.approx(wanted)
