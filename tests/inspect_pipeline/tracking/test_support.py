"""Doubtful lines are judged by the other lines of their tracks, by mean odds computed by hand."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from flights import PERIOD_NS, START_NS, frame

from inspect_pipeline.detection import ProcessedFrame, StageTimes, judge_by_tracks
from inspect_pipeline.tracking.support import MOST_FRAMES, REACH_NS, candidate_score
from lsnet.segments import Detections, Lines, Segments

if TYPE_CHECKING:
    from collections.abc import Iterator

SIZE = (480, 640)
MIN_SCORE = 0.5


def found(*lines: tuple[float, float]) -> Detections:
    """Lines across the image, of (height in px, score), each with one segment."""
    chords = np.array([(0, y, 640, y) for y, _ in lines], np.float32).reshape(-1, 4)
    scores = np.array([score for _, score in lines], np.float32)
    points = tuple(chord.reshape(2, 2) for chord in chords)
    line_of = np.arange(len(lines), dtype=np.int32)
    return Detections(Segments(chords, scores, SIZE), Lines(points, scores, SIZE), line_of)


def judge(*frames: Detections | None, period_ns: int = PERIOD_NS) -> list[ProcessedFrame]:
    """The frames of a camera, judged; None is a bad frame."""
    given = (
        ProcessedFrame(
            frame(i, None if each else "corrupt JPEG", step=i * period_ns // PERIOD_NS), detections=each
        )
        for i, each in enumerate(frames)
    )
    return list(judge_by_tracks(given, MIN_SCORE, StageTimes()))


def scores(frames: list[ProcessedFrame]) -> list[list[float]]:
    return [
        [round(score, 3) for score in each.detections.lines.scores.tolist()] if each.detections else []
        for each in frames
    ]


def test_a_faint_line_on_a_good_track_is_reported() -> None:
    judged = judge(found((100, 0.8)), found((100, 0.35)), found((100, 0.6)), found((100, 0.7)))
    assert scores(judged) == [[0.8], [0.35], [0.6], [0.7]]
    odds = (4 * 1.5 * 7 / 3) ** (1 / 3)  # the geometric mean of those of 0.8, 0.6 and 0.7
    assert judged[1].track_scores == pytest.approx([odds / (1 + odds)])
    alone = judge(found((100, 0.35)), found((100, 0.8)), found((100, 0.8)), found((300, 0.35)))
    assert scores(alone) == [[], [0.8], [0.8], []]  # two other lines are not enough
    assert np.isnan(alone[1].track_scores).all()


def on_one_track(*line_scores: float) -> list[Detections]:
    return [found((100, score)) for score in line_scores]


def test_a_line_just_above_the_threshold_on_a_faint_track_is_left_out() -> None:
    assert scores(judge(*on_one_track(0.4, 0.55, 0.42, 0.4))) == [[], [], [], []]
    assert scores(judge(*on_one_track(0.35, 0.61, 0.38, 0.4))) == [[], [0.61], [], []]
    assert scores(judge(*on_one_track(0.9, 0.2, 0.9, 0.9))) == [[0.9], [], [0.9], [0.9]]


def test_only_frames_nearby_count() -> None:
    lines = on_one_track(0.8, 0.35, 0.8, 0.8)
    assert scores(judge(*lines, period_ns=REACH_NS // 2)) == [[0.8], [0.35], [0.8], [0.8]]
    assert scores(judge(*lines, period_ns=REACH_NS // 2 + PERIOD_NS)) == [[0.8], [], [0.8], [0.8]]


def test_segments_keep_their_lines() -> None:
    judged = judge(found((100, 0.8)), found((400, 0.35), (100, 0.45)), *on_one_track(0.8, 0.8))
    middle = judged[1].detections
    assert middle is not None
    assert middle.lines.points[0][0].tolist() == [0, 100]
    assert (len(middle.segments), middle.line_of.tolist()) == (2, [-1, 0])


def test_frames_come_in_order_without_pixels_and_do_not_wait_for_ever() -> None:
    """All images of some recordings have nearly the same time."""
    n_given = 0

    def frames() -> Iterator[ProcessedFrame]:
        nonlocal n_given
        for i in range(3 * MOST_FRAMES):
            n_given += 1
            error = "corrupt JPEG" if i % 50 == 7 else None
            each = frame(i, error, channel_id=1 + i % 2, step=0)
            yield ProcessedFrame(each, detections=None if error else found((100, 0.45), (200, 0.9)))

    numbers = []
    for each in judge_by_tracks(frames(), MIN_SCORE, StageTimes()):
        assert n_given <= each.frame.frame_idx + MOST_FRAMES + 1
        assert each.frame.image is None
        assert (each.detections is None) == (each.frame.error is not None)
        assert each.detections is None or scores([each]) == [[0.9]]
        numbers.append(each.frame.frame_idx)
    assert numbers == list(range(3 * MOST_FRAMES))
    assert each.frame.log_time_ns == START_NS


def test_candidates_scale_with_the_threshold() -> None:
    assert candidate_score(0.5) == pytest.approx(0.3)
    assert candidate_score(0.2) == pytest.approx(0.12)
