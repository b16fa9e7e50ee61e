"""Coverage of flights that are worked out by hand: a camera that looks straight down on a span."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from inspect_rows import FOCAL_PX, PERIOD_NS, flight, rules, span

from inspect_pipeline.geometry.camera import CameraPoses, camera_axes
from inspect_pipeline.inspection.anomalies.find import inspect_cameras
from inspect_pipeline.inspection.coverage.measure import measure_coverage
from inspect_pipeline.inspection.lines import carry_over
from inspect_pipeline.inspection.rows import NO_TRACK, LineRows
from inspect_pipeline.inspection.span_view import visible_gsd_m

if TYPE_CHECKING:
    from inspect_pipeline.inspection.rows import CameraRows
    from inspect_pipeline.inspection.rules import Rules
    from inspect_pipeline.inspection.spans import Span


def shares(camera: CameraRows, spans: list[Span], chosen: Rules) -> dict[str, float]:
    found = measure_coverage([camera], spans, chosen).numbers
    return {f"{one.kind} {one.unit}": one.share for one in found if one.channel_id is None}


def test_a_span_is_covered_where_its_footprints_have_the_line() -> None:
    """20 m above the conductors, a picture shows 20 m of them: from 30 m to 50 m, hovering at 40 m."""
    camera = flight(np.full(10, 40.0), np.ones(10, bool))
    found = measure_coverage([camera], [span()], rules())
    (one,) = (one for one in found.numbers if one.kind == "span")
    assert (one.total, one.imaged, one.covered) == pytest.approx((100, 20, 20), abs=0.01)
    assert one.longest_gap_m == pytest.approx(50, abs=0.01)
    (bins,) = (bins for bins in found.bins if bins.kind == "span")
    assert np.flatnonzero(bins.n_frames).tolist() == list(range(30, 50))
    assert set(bins.n_detected[30:50]) == {10}
    assert bins.best_gsd_m[40] == pytest.approx(20 / FOCAL_PX, rel=0.01)


def test_what_is_imaged_without_lines_is_not_covered() -> None:
    camera = flight(np.full(10, 40.0), np.zeros(10, bool))
    (one,) = (one for one in measure_coverage([camera], [span()], rules()).numbers if one.kind == "span")
    assert (one.imaged, one.covered) == pytest.approx((20, 0), abs=0.01)


@pytest.mark.parametrize(
    ("change", "limits", "reason"),
    [
        ({"mean_luma": 5.0}, {}, None),
        ({"is_ok": False}, {}, None),
        ({}, {"max_gsd_m": 0.01}, None),
        ({"pose_age_ms": 5000.0}, {}, "pose too old"),
        ({"is_turn_known": False}, {}, "camera attitude unknown"),
        ({"focal_px": np.nan}, {}, "lens unknown"),
        ({"height_m": np.nan}, {}, "height above ground unknown"),
    ],
)
def test_frames_that_show_nothing_cover_nothing_or_leave_it_unknown(
    change: dict[str, float], limits: dict[str, float], reason: str | None
) -> None:
    camera = flight(np.full(10, 40.0), np.ones(10, bool))
    changed = {name: np.full(10, value) for name, value in change.items()}
    camera = replace(camera, frames=replace(camera.frames, **changed))
    (one,) = (
        one for one in measure_coverage([camera], [span()], rules(**limits)).numbers if one.kind == "span"
    )
    assert one.reason == reason
    assert (one.imaged, one.covered, one.share) == ((0, 0, 0) if reason is None else (None, None, None))
    assert one.unknown == pytest.approx(0.0 if reason is None else 100.0)


def test_a_flight_without_positions_has_unknown_coverage() -> None:
    camera = flight(np.full(10, 40.0), np.ones(10, bool))
    nowhere = replace(camera, frames=replace(camera.frames, lat_deg=np.full(10, np.nan)))
    unknown = [one for one in measure_coverage([nowhere], [span()], rules()).numbers if one.total is None]
    assert [(one.kind, one.span_id, one.covered, one.share, one.reason) for one in unknown] == [
        ("span", None, None, None, "position unknown"),
        ("corridor", None, None, None, "position unknown"),
    ]


def test_spans_that_are_far_have_no_row() -> None:
    camera = flight(np.full(10, 40.0), np.ones(10, bool))
    assert "span m" not in shares(camera, [replace(span(), from_lat_deg=53.0, to_lat_deg=53.0)], rules())


def test_spans_that_are_far_change_no_row() -> None:
    """Two spans below the path have the same coverage and findings beside ones to all sides of it."""
    camera = flight(np.arange(0.0, 100.0, 2.0), np.arange(50) != 20)
    own = [span(), replace(span(60.0), span_id="beside", expected_conductors=2)]
    far = [
        replace(
            span(),
            span_id=f"{north} {east}",
            from_lat_deg=52.0 + north,
            to_lat_deg=52.0 + north,
            from_lon_deg=5.0 + east,
            to_lon_deg=span().to_lon_deg + east,
        )
        for north in (-0.01, -0.0004, 0.0, 0.0004, 0.01)
        for east in (-0.01, 0.01)
    ]
    alone, among = (measure_coverage([camera], spans, rules()) for spans in (own, [*far[:5], *own, *far[5:]]))
    assert (among.numbers, among.gaps) == (alone.numbers, alone.gaps)
    for ours, theirs in zip(alone.bins, among.bins, strict=True):
        assert (ours.span_id, ours.bin_m) == (theirs.span_id, theirs.bin_m)
        for name in ("n_frames", "n_detected", "best_gsd_m", "first_ns", "last_ns"):
            assert getattr(ours, name).tobytes() == getattr(theirs, name).tobytes()
    found, more = (inspect_cameras([camera], spans, rules()) for spans in (own, [*far[:5], *own, *far[5:]]))
    names = {one.span_id for one in own}
    assert {one.span_id for one in found.judgements} == names
    assert [one for one in more.judgements if one.span_id in names] == found.judgements
    assert more.anomalies == found.anomalies


def test_cameras_see_what_projects_into_their_pictures() -> None:
    """CameraPoses that look anywhere, wide and narrow, some lost, about a line that turns."""
    rng = np.random.default_rng(0)
    angles = rng.uniform(-180, 180, (3, 300))
    cameras = CameraPoses(
        positions=rng.uniform(-150, 150, (300, 3)),
        axes=camera_axes(np.column_stack(angles)),
        focal_px=rng.choice([100.0, 1000.0, 4000.0], 300),
        sizes=np.tile([1280.0, 720.0], (300, 1)),
    )
    cameras.positions[::50] = np.nan
    along = np.linspace(-100, 100, 200)
    points = np.column_stack((along, np.abs(along), np.full(200, 12.0)))
    found = visible_gsd_m(cameras, points, margin_px=12.0)
    n_seen = 0
    for row in range(300):
        right, down, ahead = cameras.axes[row] @ (points - cameras.positions[row]).T
        right_px, down_px = (np.abs(side) * cameras.focal_px[row] for side in (right, down))
        is_inside = (right_px <= 628 * ahead) & (down_px <= 348 * ahead)
        n_seen += is_inside.sum()
        assert np.isfinite(found[row]).tolist() == is_inside.tolist()
    assert n_seen > 1000


def test_dropped_frames_are_missing_from_frame_and_detection_coverage() -> None:
    """Of 21 moments, frames 11 to 14 did not come: 17 of 21 frames, and 15 of 20 intervals."""
    kept = np.array([i for i in range(21) if not 11 <= i <= 14])
    camera = flight(kept * 1.0, np.ones(17, bool), times_ns=kept * PERIOD_NS)
    found = shares(camera, [], rules())
    assert found["frame frames"] == pytest.approx(17 / 21)
    assert found["detection s"] == pytest.approx(15 / 20)
    assert found["detection m"] == pytest.approx(15 / 20, rel=1e-6)
    (gap,) = measure_coverage([camera], [], rules()).gaps
    assert (gap.kind, gap.first_frame_idx, gap.last_frame_idx, gap.n_frames) == ("frame", 10, 11, 4)
    assert (gap.duration_s, gap.length_m) == pytest.approx((0.5, 5.0), rel=1e-6)


def test_lines_are_lost_for_a_while() -> None:
    """Of 40 frames, 10 to 19 have no line; their neighbours stand for half an interval each."""
    seen = np.array([not 10 <= i < 20 for i in range(40)])
    camera = flight(np.arange(40.0), seen)
    assert shares(camera, [], rules())["detection s"] == pytest.approx(1 - 10 / 39)
    (gap,) = measure_coverage([camera], [], rules()).gaps
    assert (gap.kind, gap.first_frame_idx, gap.last_frame_idx, gap.n_frames) == ("detection", 10, 19, 10)
    assert (gap.duration_s, gap.length_m) == pytest.approx((0.9, 9.0), rel=1e-6)


def test_the_corridor_is_the_ground_below_the_path() -> None:
    """Pictures show 30 m of the ground around the drone; lines were seen over the first half of 100 m."""
    camera = flight(np.arange(101.0), np.arange(101) <= 50)
    assert shares(camera, [], rules())["corridor m"] == pytest.approx(0.65, abs=0.011)


def test_a_position_that_jumps_far_away_costs_no_memory() -> None:
    """One of forty frames is said to be ten degrees away; the ground below the others is seen."""
    camera = flight(np.arange(40.0), np.ones(40, bool))
    lat_deg = camera.frames.lat_deg.copy()
    lat_deg[20] += 10
    camera = replace(camera, frames=replace(camera.frames, lat_deg=lat_deg))
    tracemalloc.start()
    (bins,) = (one for one in measure_coverage([camera], [], rules()).bins if one.kind == "corridor")
    _, most_bytes = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most_bytes < 100 << 20
    assert len(bins.n_frames) == 100_000
    assert bins.n_detected.max() > 10


def test_clutter_is_no_line() -> None:
    camera = flight(np.arange(40.0), np.ones(40, bool))
    tracks = np.where(np.arange(40) < 2, 7, NO_TRACK)
    tracks[20:] = 8
    clutter = replace(camera, lines=replace(camera.lines, track=tracks))
    assert shares(clutter, [], rules())["detection s"] == pytest.approx(19.5 / 39)


def test_a_line_missed_within_its_track_is_taken_from_the_frame_before() -> None:
    frame, track = np.array([0, 0, 3, 4, 9]), np.array([1, 2, 1, 1, 1])
    points = np.arange(20.0).reshape(10, 2)
    lines = LineRows(frame, track, 2 * np.arange(6), points)
    done = carry_over(lines, 2)
    rows = [
        (int(f), int(t), done.points[a].tolist())
        for f, t, a in zip(done.frame, done.track, done.first[:-1], strict=True)
    ]
    assert sorted(rows) == [
        (0, 1, [0, 1]),
        (0, 2, [4, 5]),
        (1, 1, [0, 1]),
        (2, 1, [0, 1]),
        (3, 1, [8, 9]),
        (4, 1, [12, 13]),
        (9, 1, [16, 17]),
    ]


def test_cameras_of_a_flight_add_up() -> None:
    first = flight(np.full(10, 20.0), np.ones(10, bool))
    second = replace(flight(np.full(10, 80.0), np.zeros(10, bool)), channel_id=2)
    found = measure_coverage([first, second], [span()], rules())
    (one,) = (one for one in found.numbers if one.kind == "span")
    assert (one.imaged, one.covered) == pytest.approx((40, 20), abs=0.01)
    by_camera = {
        one.channel_id: one.share for one in found.numbers if (one.kind, one.unit) == ("detection", "s")
    }
    assert by_camera == pytest.approx({1: 1.0, 2: 0.0, None: 0.5})


def test_memory_is_bounded_for_long_flights() -> None:
    """10 km in 2,000 frames: every frame with every metre of the path would be 160 MB a column."""
    camera = flight(5.0 * np.arange(2000), np.ones(2000, bool))
    tracemalloc.start()
    found = shares(camera, [span()], rules())
    peak_bytes = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert found["corridor m"] == pytest.approx(1, abs=0.001)
    assert peak_bytes < 40e6


def test_an_empty_flight_and_one_frame() -> None:
    for n in (0, 1):
        camera = flight(np.zeros(n), np.ones(n, bool))
        found = measure_coverage([camera], [span()], rules())
        assert all(one.covered is None or np.isfinite(one.covered) for one in found.numbers)
    assert measure_coverage([], [span()], rules()).numbers == ()


def test_axes_of_a_camera() -> None:
    """North, level: right is east, down is down. Then rolled to the right: right goes down."""
    level, rolled = camera_axes([(0.0, 0.0, 0.0), (0.0, 0.0, 90.0)])
    assert level == pytest.approx(np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]), abs=1e-12)
    assert rolled == pytest.approx(np.array([[0, 0, -1], [-1, 0, 0], [0, 1, 0]]), abs=1e-12)
