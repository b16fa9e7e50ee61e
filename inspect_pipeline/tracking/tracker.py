"""Line tracker of one camera.

    tracker = LineTracker()
    for frame in frames:
        track_ids = tracker.update(frame_info, chords, scores, motion)  # one for each line
    tracks = tracker.finish()                                           # the confirmed ones

The state of a track is its angle, its offset (theta and rho) and its extent. A Kalman filter predicts each
track after the rotation of the camera is compensated. Predictions and lines are assigned by the Hungarian
algorithm. A track without a line coasts for a while before it ends.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from inspect_pipeline.tracking.kalman import KalmanState, Transition
from inspect_pipeline.tracking.measurements import FrameLines, extends_line, wrap_half_turn

if TYPE_CHECKING:
    from inspect_pipeline.arrays import Floats, Ints32, RealArray


# Standard deviation of the rates, as a share of the longer image side, or in rad, per second.
_OFFSET_RATE, _ANGLE_RATE = 90 / 1280, float(np.radians(5))
_GAP_STD = 100 / 1280  # distance between the ends of line and track that counts as one deviation
_GATE = 8.0  # squared standard deviations
_PIECE_GATE = 6.0  # for further pieces of a line that already has its track
_CONFIRMED_FRAMES = 3
_COAST_FRAMES, _TENTATIVE_COAST_FRAMES = 10, 1
_COAST_S = 5.0


class FrameInfo(NamedTuple):
    """Index and time of a frame, and the (height, width) of its image."""

    frame_idx: int
    time_ns: int
    image_size: tuple[int, int]


@dataclass(frozen=True, slots=True)
class TrackRow:
    """A confirmed track; the fields are columns of the table `tracks`."""

    track_id: int
    first_frame_idx: int
    last_frame_idx: int
    start_ns: int
    end_ns: int
    n_frames: int
    n_coasted: int
    mean_score: float
    mean_angle_deg: float
    mean_offset_px: float


@dataclass(slots=True)
class _Track:
    """A predicted line, `half_length_px` to both sides of `centre` (px from the image centre)."""

    track_id: int
    angle: KalmanState  # rad, unwrapped
    offset: KalmanState  # px across the line; its value is moved into `centre` after each step
    centre: Floats
    half_length_px: float
    first: FrameInfo
    last: FrameInfo
    sums: Floats  # of score, angle, offset from the image centre
    n_frames: int = 1
    n_missed: int = 0  # since the last line
    n_coasted: int = 0

    @property
    def is_confirmed(self) -> bool:
        return self.n_frames >= _CONFIRMED_FRAMES

    @property
    def direction(self) -> Floats:
        return np.array([math.cos(self.angle.value), math.sin(self.angle.value)])

    def predict(self, step: Transition) -> None:
        self.angle.predict(step)
        self.offset.predict(step)
        self._apply_offset()

    def warp(self, motion: Floats, image_size: tuple[int, int]) -> None:
        """Move the line by a homography (3, 3) of pixels, unless that moves it behind the camera."""
        image_centre = np.array(image_size[::-1]) / 2
        ends = self.centre + np.outer((-self.half_length_px, self.half_length_px), self.direction)
        moved = np.column_stack((ends + image_centre, np.ones(2))) @ motion.T
        if moved[:, 2].min() < 0.1:
            return
        first, last = moved[:, :2] / moved[:, 2:] - image_centre
        x, y = last - first
        self.angle.value += float(wrap_half_turn(np.arctan2(y, x) - self.angle.value))
        self.centre, self.half_length_px = (first + last) / 2, float(np.hypot(x, y)) / 2

    def update(self, frame: FrameInfo, line: FrameLines, score: float) -> None:
        """Apply one measured line."""
        turn = float(wrap_half_turn(line.angles[0] - self.angle.value))
        angle_var, offset_var = line.variances[0].tolist()
        x, y = self.direction.tolist()
        right, down = (line.centres[0] - self.centre).tolist()
        along_px, across_px = right * x + down * y, down * x - right * y
        # An error of the angle shifts the line in proportion to the distance along it.
        lever_var = along_px**2 * self.angle.value_var
        self.angle.update(turn, angle_var)
        self.offset.update(across_px, offset_var + lever_var)
        self._apply_offset()
        self.centre = self.centre + along_px * self.direction
        self.half_length_px = float(line.half_lengths[0])
        self.n_coasted += self.n_missed
        self.n_missed = 0
        self.n_frames += 1
        self.last = frame
        x, y = self.direction.tolist()
        right, down = self.centre.tolist()
        self.sums += (score, self.angle.value, down * x - right * y)

    def _apply_offset(self) -> None:
        angle, offset = self.angle.value, self.offset.value
        self.centre = self.centre + np.array([-offset * math.sin(angle), offset * math.cos(angle)])
        self.offset.value = 0.0

    def has_ended(self, time_ns: int) -> bool:
        coast_frames = _COAST_FRAMES if self.is_confirmed else _TENTATIVE_COAST_FRAMES
        return self.n_missed > coast_frames or time_ns - self.last.time_ns > _COAST_S * 1e9

    def to_row(self) -> TrackRow:
        score, angle_rad, offset_px = self.sums / self.n_frames
        half_turns, angle_rad = divmod(angle_rad, np.pi)
        return TrackRow(
            track_id=self.track_id,
            first_frame_idx=self.first.frame_idx,
            last_frame_idx=self.last.frame_idx,
            start_ns=self.first.time_ns,
            end_ns=self.last.time_ns,
            n_frames=self.n_frames,
            n_coasted=self.n_coasted,
            mean_score=float(score),
            mean_angle_deg=float(np.degrees(angle_rad)) % 180,
            mean_offset_px=float(-offset_px if half_turns % 2 else offset_px),
        )


class LineTracker:
    """Track the lines of one camera. Frames are given in time order."""

    def __init__(self) -> None:
        self._tracks: list[_Track] = []
        self._ended: list[TrackRow] = []
        self._next_id = 0
        self._time_ns: int | None = None

    def update(
        self, frame: FrameInfo, chords: Floats, scores: RealArray, motion: Floats | None = None
    ) -> Ints32:
        """Assign the lines of a frame to tracks.

        Args:
            frame: index, time and image size of the frame.
            chords: (N, 4) end points x1, y1, x2, y2 in px.
            scores: (N,).
            motion: homography (3, 3) from pixels of the previous frame to pixels of this one, None where the
                rotation of the camera is unknown.

        Returns:
            Track ids (N,). Those that `finish` does not return were never confirmed.
        """
        self._predict(frame, motion)
        lines = FrameLines.from_chords(chords, frame.image_size)
        track_ids = np.full(len(chords), -1, np.int32)
        assigned = _assign(self._tracks, lines, max(frame.image_size))
        for number, track in enumerate(self._tracks):
            pieces = assigned.get(number)
            if pieces is None:
                track.n_missed += 1
            else:
                track_ids[pieces] = track.track_id
                track.update(frame, lines.merge(pieces, track.direction), float(scores[pieces].max()))
        for i in np.flatnonzero(track_ids < 0).tolist():
            track_ids[i] = self._start_track(frame, lines, i, float(scores[i]))
        self._end_lost(frame.time_ns)
        return track_ids

    def finish(self) -> list[TrackRow]:
        """Return all confirmed tracks in the order of their first frames."""
        self._ended += [track.to_row() for track in self._tracks if track.is_confirmed]
        self._tracks = []
        return sorted(self._ended, key=lambda row: row.track_id)

    def _predict(self, frame: FrameInfo, motion: Floats | None) -> None:
        elapsed_s = (frame.time_ns - self._time_ns) / 1e9 if self._time_ns is not None else 0.0
        self._time_ns = frame.time_ns
        step = Transition.over(max(elapsed_s, 0.0))
        for track in self._tracks:
            if motion is not None:
                track.warp(motion, frame.image_size)
            track.predict(step)

    def _start_track(self, frame: FrameInfo, lines: FrameLines, i: int, score: float) -> int:
        angle, (angle_var, offset_var) = float(lines.angles[i]), lines.variances[i].tolist()
        track = _Track(
            track_id=self._next_id,
            angle=KalmanState(angle, angle_var, _ANGLE_RATE),
            offset=KalmanState(0.0, offset_var, _OFFSET_RATE * max(frame.image_size)),
            centre=lines.centres[i],
            half_length_px=float(lines.half_lengths[i]),
            first=frame,
            last=frame,
            sums=np.array([score, angle, lines.centres[i] @ (-np.sin(angle), np.cos(angle))]),
        )
        self._tracks.append(track)
        self._next_id += 1
        return track.track_id

    def _end_lost(self, time_ns: int) -> None:
        ended = [track for track in self._tracks if track.has_ended(time_ns)]
        self._ended += [track.to_row() for track in ended if track.is_confirmed]
        self._tracks = [track for track in self._tracks if not track.has_ended(time_ns)]


def _assign(tracks: list[_Track], lines: FrameLines, longer_px: int) -> dict[int, list[int]]:
    """Return the lines of each track that has any, keyed by its position in the list."""
    if not tracks or not len(lines.angles):
        return {}
    costs = _costs(tracks, lines, longer_px)
    # A track without a line costs as much as the worst line that it may take.
    padded = np.hstack((np.minimum(costs, 2 * _GATE), np.full((len(costs), len(costs)), _GATE)))
    from scipy.optimize import linear_sum_assignment  # noqa: PLC0415, half of the time publish takes to start

    rows, columns = linear_sum_assignment(padded)
    assigned = {
        row: [column]
        for row, column in zip(rows.tolist(), columns.tolist(), strict=True)
        if column < costs.shape[1] and costs[row, column] < _GATE
    }
    _add_pieces(assigned, costs, lines, tracks)
    return assigned


def _costs(tracks: list[_Track], lines: FrameLines, longer_px: int) -> Floats:
    """Return the squared Mahalanobis distances (T, N) of lines from tracks, with a term for gaps between."""
    angles, angle_vars, offset_vars, half_lengths = np.array(
        [(t.angle.value, t.angle.value_var, t.offset.value_var, t.half_length_px) for t in tracks]
    ).T[..., np.newaxis]
    difference = lines.centres - np.array([track.centre for track in tracks])[:, np.newaxis]
    cosine, sine = np.cos(angles), np.sin(angles)
    along = difference[..., 0] * cosine + difference[..., 1] * sine
    across = difference[..., 1] * cosine - difference[..., 0] * sine
    turns = wrap_half_turn(lines.angles - angles)
    gaps = np.maximum(0, np.abs(along) - half_lengths - lines.half_lengths * np.abs(np.cos(turns)))
    costs: Floats = (
        across**2 / (offset_vars + lines.variances[:, 1] + along**2 * angle_vars)
        + turns**2 / (angle_vars + lines.variances[:, 0])
        + (gaps / (_GAP_STD * longer_px)) ** 2
    )
    return costs


def _add_pieces(
    assigned: dict[int, list[int]], costs: Floats, lines: FrameLines, tracks: list[_Track]
) -> None:
    """Assign lines without a track to tracks whose lines they extend, nearest track first."""
    taken = {piece for pieces in assigned.values() for piece in pieces}
    for i in range(costs.shape[1]):
        for row in np.argsort(costs[:, i]).tolist() if i not in taken else ():
            if costs[row, i] > _PIECE_GATE:
                break
            if row in assigned and extends_line(lines.ends @ tracks[row].direction, assigned[row], i):
                assigned[row].append(i)
                break
