"""Let tracks decide on doubtful lines: those whose score is near the least score that is reported.

    support = TrackSupport(min_score)
    for ... in frames:
        support.add(frame, lines, pose)     # candidates included; once for each frame, in time order
    support.judge(frame, lines)             # once the frames of the next two seconds are added

A track is as good as its lines in the other frames nearby. Where it has at least three of them, their mean
odds decide on a doubtful line: a faint line on a good track is reported, and a line that only just reaches
the threshold on a track that mostly does not is left out. All other lines are judged by their own score.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from inspect_pipeline.tracking.flight import FlightTracker

if TYPE_CHECKING:
    from inspect_pipeline.arrays import Floats, Floats32, Ints32, Mask, RealArray
    from inspect_pipeline.georeference.frame_pose import FramePose
    from inspect_pipeline.recording.types import Frame
    from lsnet.segments import Lines

REACH_NS = 2_000_000_000  # before and after a frame
MOST_FRAMES = 128  # that wait to be judged, however many a second
_DOUBTFUL = (0.6, 1.2)  # times the least score
_MIN_LINES = 3  # of a track, in other frames
_LEAST_DOUBT = 0.01  # keeps odds finite


class Judgement(NamedTuple):
    """Which lines of a frame are reported (N,), and the score of the track of each, NaN if unknown."""

    is_reported: Mask
    track_scores: Floats32


class _Sighting(NamedTuple):
    """The tracks of a frame: the track id of each line (N,), and the log-odds of the best line of each."""

    frame_idx: int
    time_ns: int
    track_ids: Ints32
    log_odds: dict[int, float]


def candidate_score(min_score: float) -> float:
    """Return the least score of a line that a track may support."""
    return _DOUBTFUL[0] * min_score


class TrackSupport:
    """Judge the lines of a flight with candidates, by their tracks; see above."""

    def __init__(self, min_score: float) -> None:
        self._min_score = min_score
        self._tracker = FlightTracker()
        self._nearby: dict[int, deque[_Sighting]] = {}  # of each camera

    def add(self, frame: Frame, lines: Lines, pose: FramePose) -> None:
        """Follow the lines of a frame."""
        track_ids = self._tracker.follow(frame, lines, pose)
        best: dict[int, float] = {}
        for track_id, odds in zip(track_ids.tolist(), _log_odds(lines.scores).tolist(), strict=True):
            best[track_id] = max(odds, best.get(track_id, -np.inf))
        nearby = self._nearby.setdefault(frame.channel_id, deque(maxlen=2 * MOST_FRAMES))
        nearby.append(_Sighting(frame.frame_idx, frame.log_time_ns, track_ids, best))

    def judge(self, frame: Frame, lines: Lines) -> Judgement:
        """Judge the lines of a frame that is one of the last MOST_FRAMES added."""
        nearby = self._nearby[frame.channel_id]
        here = next(each for each in nearby if each.frame_idx == frame.frame_idx)
        others_nearby = [
            each.log_odds
            for each in nearby
            if each is not here and abs(each.time_ns - here.time_ns) <= REACH_NS
        ]
        track_scores = np.full(len(lines), np.nan, np.float32)
        for i, track_id in enumerate(here.track_ids.tolist()):
            others = [odds[track_id] for odds in others_nearby if track_id in odds]
            if len(others) >= _MIN_LINES:
                track_scores[i] = 1 / (1 + np.exp(-np.mean(others)))
        return Judgement(self._is_reported(lines.scores, track_scores), track_scores)

    def _is_reported(self, scores: Floats32, track_scores: Floats32) -> Mask:
        low, high = (factor * self._min_score for factor in _DOUBTFUL)
        is_doubtful = (scores >= low) & (scores < high) & np.isfinite(track_scores)
        reported: Mask = np.where(is_doubtful, track_scores, scores) >= self._min_score
        return reported


def _log_odds(scores: RealArray) -> Floats:
    bounded = np.clip(scores, _LEAST_DOUBT, 1 - _LEAST_DOUBT, dtype=np.float64)
    odds: Floats = np.log(bounded / (1 - bounded))
    return odds
