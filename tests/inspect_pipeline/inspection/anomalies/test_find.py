"""Anomalies: by hand-made rows, and by simulated flights whose truth shares no code with the rules."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import inspected
import numpy as np
import pytest
from inspect_rows import flight, rules, span

from inspect_pipeline.errors import RulesError
from inspect_pipeline.index import publish as index
from inspect_pipeline.index.reading import select
from inspect_pipeline.inspection.anomalies.find import Reviewed, find_anomalies, inspect_cameras, with_ids
from inspect_pipeline.inspection.rows import NO_TRACK, CameraRows, LineRows
from inspect_pipeline.inspection.rules import load_rules
from inspect_pipeline.inspection.spans import import_spans
from inspect_pipeline.simulation.options import FaultKind, FlightKind, SimulationOptions
from inspect_pipeline.simulation.truth import simulate_truth
from inspect_pipeline.store.store import Store

if TYPE_CHECKING:
    from pathlib import Path

RULES = rules()


def found(camera: CameraRows, kind: str | None = None) -> list[tuple[str, int, int]]:
    anomalies = find_anomalies([camera], [span(expected=3)], RULES)
    return [
        (one.kind, one.first_frame_idx, one.last_frame_idx) for one in anomalies if kind in {None, one.kind}
    ]


def spoiled(**changes: tuple[slice, float]) -> CameraRows:
    """Forty frames, some of whose values are changed."""
    camera = flight(np.arange(40.0), np.ones(40, bool))
    columns = {}
    for name, (rows, value) in changes.items():
        columns[name] = getattr(camera.frames, name).copy()
        columns[name][rows] = value
    return replace(camera, frames=replace(camera.frames, **columns))


@pytest.mark.parametrize(
    ("changes", "wanted"),
    [
        ({"sharpness": (slice(5, 9), 10.0)}, [("blurred_frames", 5, 8)]),
        ({"mean_luma": (slice(5, 9), 10.0)}, [("dark_frames", 5, 8)]),
        ({"mean_luma": (slice(5, 9), 250.0)}, [("overexposed_frames", 5, 8)]),
        ({"mean_luma": (slice(5, 6), 250.0)}, []),
        ({"sharpness": (slice(None), 0.5)}, []),
    ],
)
def test_rules_about_pictures(
    changes: dict[str, tuple[slice, float]], wanted: list[tuple[str, int, int]]
) -> None:
    assert [one for one in found(spoiled(**changes)) if one[0].endswith("_frames")] == wanted


@pytest.mark.parametrize(("stop", "wanted"), [(40, [("clock_step", 19, 20)]), (21, [])])
def test_a_clock_steps_when_it_stays_ahead(stop: int, wanted: list[tuple[str, int, int]]) -> None:
    """From frame 20 on the camera's clock is 9 s ahead; a single stamp that is off says nothing."""
    camera = flight(np.arange(40.0), np.ones(40, bool))
    ahead_ns = np.where((np.arange(40) >= 20) & (np.arange(40) < stop), 9 * 10**9, 0)
    stamps_ns = camera.frames.log_time_ns + ahead_ns
    assert found(replace(camera, frames=replace(camera.frames, stamp_ns=stamps_ns)), "clock_step") == wanted


def test_a_pose_is_stale_from_when_it_was_last_heard() -> None:
    """The pose of frame 10 is the last; at frame 21 it is 1.1 s old."""
    ages_ms = np.where(np.arange(40) <= 10, 0.0, 100.0 * (np.arange(40) - 10))
    ages_ms[30:] = 0
    camera = flight(np.arange(40.0), np.ones(40, bool))
    camera = replace(camera, frames=replace(camera.frames, pose_age_ms=ages_ms))
    assert found(camera, "stale_pose") == [("stale_pose", 10, 29)]


def test_a_pause_is_a_dropout() -> None:
    kept = np.array([i for i in range(40) if not 11 <= i <= 14])
    camera = flight(kept * 1.0, np.ones(36, bool), times_ns=kept * 100_000_000)
    (one,) = (a for a in find_anomalies([camera], [], RULES) if a.kind == "sensor_dropout")
    assert (one.first_frame_idx, one.last_frame_idx) == (10, 11)
    assert one.value == pytest.approx(0.5)
    assert "about 4 are missing" in one.reason


def test_a_rule_that_is_switched_off_finds_nothing(tmp_path: Path) -> None:
    path = tmp_path / "rules.toml"
    path.write_text("[anomalies.dark_frames]\nenabled = false\n[frames]\ndark_below_luma = 30\n")
    camera = spoiled(mean_luma=(slice(5, 9), 28.0))
    own = load_rules(path)
    assert not find_anomalies([camera], [], own)
    assert own.frames["dark_below_luma"] == 30
    assert not found(camera, "dark_frames")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[frames]\ndrak = 1", "unknown name frames.drak"),
        ("[frames]\ndark_below_luma = 'x'", "the wrong type"),
        ("frames = 3", "the wrong type"),
        ("[check]\nfail_on = 'x'", "the wrong type"),
        ("[check]\nfail_on = ['blured_frames']", "unknown kind 'blured_frames'; known here: conductor_count"),
        ("[coverage]\nbin_m = 0", "coverage.bin_m is 0; give a number of at least 0.01, such as 1.0"),
        ("[coverage]\nnear_m = nan", "coverage.near_m is nan"),
        ("[anomalies.stale_pose]\nmax_age_ms = -1", "anomalies.stale_pose.max_age_ms is -1"),
        ("[check]\nmin_span_share = 80", "check.min_span_share is 80; give a number from 0 to 1, such as"),
        ("[", "is not valid TOML"),
    ],
)
def test_invalid_rules_raise_one_line(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "rules.toml"
    path.write_text(text)
    with pytest.raises(RulesError, match=words):
        load_rules(path)
    with pytest.raises(RulesError, match="cannot be read"):
        load_rules(tmp_path / "none.toml")


def three_lines(n: int, present: np.ndarray, turn_deg: np.ndarray | float = 0.0) -> CameraRows:
    """A hover over the middle of the span: lines 200 px apart up the picture; present (n, 3) says which."""
    camera = flight(np.full(n, 50.0), np.zeros(n, bool))
    rows, which = np.nonzero(present)
    turns = np.radians(np.broadcast_to(turn_deg, n)[rows])
    offset = (which - 1) * 200.0
    direction, normal = (
        np.stack((np.sin(turns), -np.cos(turns)), 1),
        np.stack((np.cos(turns), np.sin(turns)), 1),
    )
    middle = 500.0 + offset[:, None] * normal
    points = np.stack((middle - 400 * direction, middle + 400 * direction), 1).reshape(-1, 2)
    return replace(camera, lines=LineRows(rows, which, 2 * np.arange(len(rows) + 1), points))


def test_lines_that_turn_together_are_an_orientation_jump() -> None:
    turned = np.where(np.arange(40) < 25, 0.0, 25.0)
    assert found(three_lines(40, np.ones((40, 3), bool), turned), "orientation_jump") == [
        ("orientation_jump", 24, 25)
    ]
    slowly = 0.5 * np.arange(40)
    assert found(three_lines(40, np.ones((40, 3), bool), slowly), "orientation_jump") == []


def test_lines_that_turn_while_errors_of_positions_shift_them_are_an_orientation_jump() -> None:
    def shifted(turned: np.ndarray) -> CameraRows:
        camera = three_lines(40, np.ones((40, 3), bool), turned)
        aside_px = np.random.default_rng(1).uniform(-60, 60, 40)[np.repeat(camera.lines.frame, 2)]
        points = camera.lines.points + aside_px[:, None] * (1.0, 0.0)
        return replace(camera, lines=replace(camera.lines, points=points))

    assert found(shifted(np.zeros(40)), "orientation_jump") == []
    turned = np.where(np.arange(40) < 25, 0.0, 25.0)
    assert found(shifted(turned), "orientation_jump") == [("orientation_jump", 24, 25)]


def with_line_across(rows: np.ndarray) -> CameraRows:
    """Three lines in forty frames, and one across them in some of these, track 9."""
    camera = three_lines(40, np.ones((40, 3), bool))
    across = np.tile([[100.0, 480.0], [900.0, 520.0]], (len(rows), 1))
    lines = camera.lines
    frame, track = np.append(lines.frame, rows), np.append(lines.track, np.full(len(rows), 9))
    order = np.argsort(frame, kind="stable")
    points = np.concatenate((lines.points, across)).reshape(-1, 2, 2)[order].reshape(-1, 2)
    return replace(camera, lines=LineRows(frame[order], track[order], 2 * np.arange(len(frame) + 1), points))


def test_a_line_across_the_others_is_reported() -> None:
    camera = with_line_across(np.arange(10, 20))
    (one,) = (a for a in find_anomalies([camera], [], RULES) if a.kind == "crossing_line")
    assert (one.first_frame_idx, one.last_frame_idx, one.track_id) == (10, 19, 9)
    assert one.value == pytest.approx(87.1, abs=0.2)


def test_a_line_across_a_span_needs_no_track() -> None:
    camera = with_line_across(np.arange(10, 40))
    untracked = replace(camera.lines, track=np.full(len(camera.lines), NO_TRACK))
    found = find_anomalies([replace(camera, lines=untracked)], [span(expected=3)], RULES)
    assert [one.track_id for one in found if one.kind == "crossing_line"] == [None]


def test_a_conductor_that_no_span_shows_may_be_hidden() -> None:
    """Two lines where the span says three: one is missing, or always behind another; nobody can know."""
    present = np.tile([True, False, True], (40, 1))
    found = inspect_cameras([three_lines(40, present)], [span(expected=3)], RULES)
    assert not found.anomalies
    metres = {one.outcome: one.length_m for one in found.judgements if one.kind == "conductor_count"}
    assert "judged" not in metres
    assert metres["wires aligned"] > 10
    everything = inspect_cameras([three_lines(40, np.ones((40, 3), bool))], [span(expected=3)], RULES)
    assert not everything.anomalies
    assert "judged" in {one.outcome for one in everything.judgements if one.kind == "conductor_count"}


def test_conductors_that_are_judged_nowhere_are_listed() -> None:
    """A fourth line 4 px beside another in all frames: it cannot be told whether both are there all along."""
    camera = three_lines(40, np.ones((40, 3), bool))
    lines, points = camera.lines, camera.lines.points.reshape(-1, 2, 2)
    frame, track = np.append(lines.frame, np.arange(40)), np.append(lines.track, np.full(40, 9))
    order = np.argsort(frame, kind="stable")
    points = np.concatenate((points, points[2::3] + np.array([4, 0])))[order].reshape(-1, 2)
    camera = replace(camera, lines=LineRows(frame[order], track[order], 2 * np.arange(161), points))
    rows = inspect_cameras([camera], [span(expected=4)], RULES).conductors
    assert [row.judged_m > 0 for row in rows] == [False, False, True, True]
    assert [row.across_m for row in rows] == pytest.approx([-4.08, -4, 0, 4], abs=0.05)


def test_a_line_that_ends_in_the_picture_is_a_lost_conductor() -> None:
    camera = three_lines(40, np.ones((40, 3), bool))
    points = camera.lines.points.copy().reshape(-1, 2, 2)
    points[camera.lines.track == 1, 1, 1] = 500.0  # the one in the middle ends there
    cut = replace(camera, lines=replace(camera.lines, points=points.reshape(-1, 2)))
    (one,) = find_anomalies([cut], [span(expected=3)], RULES)
    assert (one.kind, one.span_id) == ("conductor_lost", "A-B")
    assert "2 of 3 conductors beyond 50 m" in one.reason
    assert one.lat_deg == pytest.approx(52.0, abs=1e-5)


def test_a_gap_that_frames_show_a_metre_apart_is_found() -> None:
    """2 m (100 px) without the line in the middle, 1 m farther in every other frame: all agree on 1 m."""
    camera = three_lines(40, np.ones((40, 3), bool))
    middle = camera.lines.points.reshape(-1, 3, 2, 2)[:, 1]
    start_px = np.where(np.arange(40) % 2, 500.0, 450.0)
    before, after = middle.copy(), middle.copy()
    before[:, 1, 1], after[:, 0, 1] = start_px + 100, start_px
    others = camera.lines.points.reshape(-1, 3, 2, 2)[:, ::2]
    points = np.concatenate((others, before[:, np.newaxis], after[:, np.newaxis]), axis=1)
    tracks = np.tile([0, 2, 1, 3], 40)
    lines = LineRows(np.repeat(np.arange(40), 4), tracks, 2 * np.arange(161), points.reshape(-1, 2))
    (one,) = find_anomalies([replace(camera, lines=lines)], [span(expected=3)], RULES)
    assert (one.kind, one.value) == ("conductor_gap", pytest.approx(2, abs=1.01))


@pytest.mark.parametrize(("piece_px", "outcome"), [(0.0, "judged"), (120.0, "lines in pieces")])
def test_where_lines_are_in_pieces_absence_is_not_judged(piece_px: float, outcome: str) -> None:
    """A piece of each line is missing somewhere in each frame, and the upper end of one line in all."""
    camera = three_lines(40, np.ones((40, 3), bool))
    whole = camera.lines.points.reshape(-1, 2, 2)
    whole[camera.lines.track == 1, 1, 1] = 500.0
    cut_px = np.random.default_rng(8).uniform(550, 700, len(whole))
    before, after = whole.copy(), whole.copy()
    before[:, 1, 1], after[:, 0, 1] = cut_px + piece_px, cut_px
    points = np.stack((before, after), axis=1).reshape(-1, 2)
    frame, track = np.repeat(camera.lines.frame, 2), np.repeat(camera.lines.track, 2)
    lines = LineRows(frame, track, 2 * np.arange(len(frame) + 1), points)
    found = inspect_cameras([replace(camera, lines=lines)], [span(expected=3)], RULES)
    outcomes = {one.outcome for one in found.judgements if one.kind == "conductor_lost"}
    assert outcome in outcomes
    assert {"judged", "lines in pieces"} & outcomes == {outcome}
    assert [one.kind for one in found.anomalies] == ([] if piece_px else ["conductor_lost"])


def test_lines_missed_here_and_there_are_no_anomaly() -> None:
    present = np.random.default_rng(3).random((200, 3)) > 0.1
    assert not find_anomalies([three_lines(200, present)], [span(expected=3)], RULES)


def test_without_a_recorded_attitude_nothing_is_said_of_conductors() -> None:
    camera = three_lines(40, np.tile([True, False, True], (40, 1)))
    assumed = replace(camera, frames=replace(camera.frames, is_turn_known=np.zeros(40, bool)))
    assert not find_anomalies([assumed], [span(expected=3)], RULES)


def test_ids_last_when_ends_move_a_little() -> None:
    first = with_ids("f", find_anomalies([spoiled(mean_luma=(slice(5, 9), 1.0))], [], RULES), [])
    again = find_anomalies([spoiled(mean_luma=(slice(4, 9), 1.0))], [], RULES)
    (old,) = first
    reviewed = [Reviewed(old.anomaly_id, old.kind, old.channel_id, old.span_id, old.start_ns, old.end_ns)]
    assert [one.anomaly_id for one in with_ids("f", again, reviewed)] == [old.anomaly_id]
    assert [one.anomaly_id for one in with_ids("f", again, [])] != [old.anomaly_id]
    elsewhere = find_anomalies([spoiled(mean_luma=(slice(30, 34), 1.0))], [], RULES)
    assert [one.anomaly_id for one in with_ids("f", elsewhere, reviewed)] != [old.anomaly_id]
    assert [one.anomaly_id for one in with_ids("g", again, [])] != [
        one.anomaly_id for one in with_ids("f", again, [])
    ]


@pytest.mark.parametrize(
    ("fault", "kind"),
    [
        (FaultKind.BROKEN_CONDUCTOR, "conductor_lost"),
        (FaultKind.CONDUCTOR_GAP, "conductor_gap"),
        (FaultKind.SAG_OUTLIER, "sag_change"),
        (FaultKind.CONDUCTORS_TOO_CLOSE, "conductors_converging"),
    ],
)
@pytest.mark.slow
def test_planted_faults_of_the_line_are_found_and_nothing_else(
    tmp_path: Path, fault: FaultKind, kind: str
) -> None:
    """The bench has twenty of each; this one is quick."""
    truth = simulate_truth(SimulationOptions(30, 4, seed=7, faults=(fault,)))
    (planted,) = truth.faults
    (one,) = published(tmp_path, truth, np.random.default_rng(1))
    assert (one["kind"], one["span_id"]) == (kind, planted.span_id)
    assert min(one["end_ns"], planted.end_ns) - max(one["start_ns"], planted.start_ns) > 0.5 * (
        max(one["end_ns"], planted.end_ns) - min(one["start_ns"], planted.start_ns)
    )


def test_clean_flights_have_no_anomalies(tmp_path: Path) -> None:
    for flown in (FlightKind.PASS_BY, FlightKind.ORBIT):
        truth = simulate_truth(SimulationOptions(10, 4, seed=8, flight=flown))
        assert published(tmp_path / flown, truth, np.random.default_rng(1)) == []


def published(folder: Path, truth: object, rng: np.random.Generator) -> list[dict[str, object]]:
    store = Store(folder)
    inspected.write_truth(store, "flight", truth, rng)
    import_spans(store, inspected.spans_of(truth))
    index.publish(store)
    return select(store, "SELECT * FROM anomalies ORDER BY start_ns")
