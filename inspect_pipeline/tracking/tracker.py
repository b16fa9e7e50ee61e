"""Lines followed over the frames of a camera.

    tracker = LineTracker()
    for frame in frames:
        track_ids = tracker.update(moment, chords, scores, motion)     # one for each line
    tracks = tracker.finish()                                          # the ones that were confirmed

A line is its direction and its distance aside (theta and rho), and how far it extends. A Kalman filter says
where each track is expected, after the camera's own turn is undone; expectations and lines are matched by the
Hungarian algorithm. A track that finds no line coasts for a while before it ends.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from inspect_pipeline.tracking.kalman import KalmanState, Pace
from inspect_pipeline.tracking.measurements import FrameLines, continues, half_turned

if TYPE_CHECKING:
    from inspect_pipeline.arrays import Floats, Ints32, RealArray


# As a share of the longer side of the image, or in rad, a second: how fast lines may drift.
_ASIDE_SPEED, _ANGLE_SPEED = 90 / 1280, float(np.radians(5))
_GAP_SHARE = 100 / 1280  # between the ends of a line and of the track, as bad as a standard deviation
_GATE = 8.0  # squared standard deviations
_PIECE_GATE = 6.0  # for further pieces of a line that is found already
_CONFIRMED_FRAMES = 3
_COAST_FRAMES, _TENTATIVE_COAST_FRAMES = 10, 1
_COAST_S = 5.0


class Moment(NamedTuple):
    """Which frame, when, and the (height, width) of its image."""

    frame_idx: int
    time_ns: int
    image_size: tuple[int, int]


@dataclass(frozen=True, slots=True)
class TrackRow:
    """A track that was confirmed; the fields are those of the table `tracks`."""

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
    """A line as it is expected: through `middle` (px from that of the image), `half_px` to either side."""

    track_id: int
    angle: KalmanState  # rad, unwrapped
    aside: KalmanState  # px off the middle, moved into it at once
    middle: Floats
    half_px: float
    first: Moment
    last: Moment
    sums: Floats  # of score, angle, offset from the middle of the image
    n_frames: int = 1
    n_missed: int = 0  # since it was last found
    n_coasted: int = 0

    @property
    def is_confirmed(self) -> bool:
        return self.n_frames >= _CONFIRMED_FRAMES

    @property
    def direction(self) -> Floats:
        return np.array([np.cos(self.angle.value), np.sin(self.angle.value)])

    def move_aside(self) -> None:
        x, y = self.direction
        self.middle = self.middle + self.aside.value * np.array([-y, x])
        self.aside.value = 0.0

    def go_on(self, pace: Pace) -> None:
        self.angle.go_on(pace)
        self.aside.go_on(pace)
        self.move_aside()

    def turn(self, motion: Floats, image_size: tuple[int, int]) -> None:
        """Go where the camera's turn moves the pixels of the line; what is turned out of sight stays."""
        height, width = image_size
        ends = self.middle + np.outer((-self.half_px, self.half_px), self.direction) + (width / 2, height / 2)
        moved = np.column_stack((ends, np.ones(2))) @ motion.T
        if moved[:, 2].min() < 0.1:
            return
        first, last = moved[:, :2] / moved[:, 2:] - (width / 2, height / 2)
        x, y = last - first
        self.angle.value += float(half_turned(np.arctan2(y, x) - self.angle.value))
        self.middle, self.half_px = (first + last) / 2, float(np.hypot(x, y)) / 2

    def correct(self, moment: Moment, line: FrameLines, score: float) -> None:
        """Draw it towards the one line that was found."""
        turn = float(half_turned(line.angles[0] - self.angle.value))
        angle_var, aside_var = line.noise[0].tolist()
        x, y = self.direction
        away = line.middles[0] - self.middle
        along_px = float(away @ (x, y))
        # An error of the angle shifts the line at a distance along it.
        aside_px, shift_var = float(away @ (-y, x)), along_px**2 * self.angle.value_var
        self.angle.correct(turn, angle_var)
        self.aside.correct(aside_px, aside_var + shift_var)
        self.move_aside()
        self.middle, self.half_px = self.middle + along_px * self.direction, float(line.halves[0])
        self.n_coasted += self.n_missed
        self.n_missed = 0
        self.n_frames += 1
        self.last = moment
        self.sums += (score, self.angle.value, self._offset_px())

    def _offset_px(self) -> float:
        x, y = self.direction
        return float(self.middle @ (-y, x))

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
    """Follows the lines of one camera; frames come in the order of time."""

    def __init__(self) -> None:
        self._tracks: list[_Track] = []
        self._ended: list[TrackRow] = []
        self._next_id = 0
        self._time_ns: int | None = None

    def update(
        self, moment: Moment, chords: Floats, scores: RealArray, motion: Floats | None = None
    ) -> Ints32:
        """The track of each line of a frame.

        chords: (N, 4) x1, y1, x2, y2 in px; scores: (N,). motion: (3, 3) from the pixels of the frame before
        to those of this one, as the camera turned; None where that is not known. Lines of tracks that
        `finish` does not name belong to none.
        """
        self._advance(moment, motion)
        lines = FrameLines.of(chords, moment.image_size)
        track_ids = np.full(len(chords), -1, np.int32)
        found = _match(self._tracks, lines, max(moment.image_size))
        for number, track in enumerate(self._tracks):
            pieces = found.get(number)
            if pieces is None:
                track.n_missed += 1
            else:
                track_ids[pieces] = track.track_id
                track.correct(moment, lines.joined(pieces, track.direction), float(scores[pieces].max()))
        for i in np.flatnonzero(track_ids < 0).tolist():
            track_ids[i] = self._begin(moment, lines, i, float(scores[i]))
        self._end_lost(moment.time_ns)
        return track_ids

    def finish(self) -> list[TrackRow]:
        """All confirmed tracks, in the order they began."""
        self._ended += [track.to_row() for track in self._tracks if track.is_confirmed]
        self._tracks = []
        return sorted(self._ended, key=lambda row: row.track_id)

    def _advance(self, moment: Moment, motion: Floats | None) -> None:
        """Move all tracks to where they are expected now."""
        elapsed_s = (moment.time_ns - self._time_ns) / 1e9 if self._time_ns is not None else 0.0
        self._time_ns = moment.time_ns
        pace = Pace.of(max(elapsed_s, 0.0))
        for track in self._tracks:
            if motion is not None:
                track.turn(motion, moment.image_size)
            track.go_on(pace)

    def _begin(self, moment: Moment, lines: FrameLines, i: int, score: float) -> int:
        angle, (angle_var, aside_var) = float(lines.angles[i]), lines.noise[i].tolist()
        track = _Track(
            track_id=self._next_id,
            angle=KalmanState(angle, angle_var, _ANGLE_SPEED),
            aside=KalmanState(0.0, aside_var, _ASIDE_SPEED * max(moment.image_size)),
            middle=lines.middles[i],
            half_px=float(lines.halves[i]),
            first=moment,
            last=moment,
            sums=np.array([score, angle, lines.middles[i] @ (-np.sin(angle), np.cos(angle))]),
        )
        self._tracks.append(track)
        self._next_id += 1
        return track.track_id

    def _end_lost(self, time_ns: int) -> None:
        ended = [track for track in self._tracks if track.has_ended(time_ns)]
        self._ended += [track.to_row() for track in ended if track.is_confirmed]
        self._tracks = [track for track in self._tracks if not track.has_ended(time_ns)]


def _match(tracks: list[_Track], lines: FrameLines, longer_px: int) -> dict[int, list[int]]:
    """The lines of each track that is found, by its number in the list."""
    if not tracks or not len(lines.angles):
        return {}
    costs = _costs(tracks, lines, longer_px)
    # A track without a line costs as much as the worst line that it may take.
    padded = np.hstack((np.minimum(costs, 2 * _GATE), np.full((len(costs), len(costs)), _GATE)))
    from scipy.optimize import linear_sum_assignment  # noqa: PLC0415, half of what publishing waits for

    rows, columns = linear_sum_assignment(padded)
    found = {
        row: [column]
        for row, column in zip(rows.tolist(), columns.tolist(), strict=True)
        if column < costs.shape[1] and costs[row, column] < _GATE
    }
    _add_pieces(found, costs, lines, tracks)
    return found


def _costs(tracks: list[_Track], lines: FrameLines, longer_px: int) -> Floats:
    """(T, N): how far each line is from what each track expects, in squared standard deviations."""
    angles, angle_vars, aside_vars, halves = np.array(
        [(t.angle.value, t.angle.value_var, t.aside.value_var, t.half_px) for t in tracks]
    ).T[..., np.newaxis]
    away = lines.middles - np.array([track.middle for track in tracks])[:, np.newaxis]
    cosine, sine = np.cos(angles), np.sin(angles)
    along, aside = away[..., 0] * cosine + away[..., 1] * sine, away[..., 1] * cosine - away[..., 0] * sine
    turns = half_turned(lines.angles - angles)
    gaps = np.maximum(0, np.abs(along) - halves - lines.halves * np.abs(np.cos(turns)))
    costs: Floats = (
        aside**2 / (aside_vars + lines.noise[:, 1] + along**2 * angle_vars)
        + turns**2 / (angle_vars + lines.noise[:, 0])
        + (gaps / (_GAP_SHARE * longer_px)) ** 2
    )
    return costs


def _add_pieces(found: dict[int, list[int]], costs: Floats, lines: FrameLines, tracks: list[_Track]) -> None:
    """Give lines that no track has to tracks that they continue, nearest first."""
    taken = {piece for pieces in found.values() for piece in pieces}
    for i in range(costs.shape[1]):
        for row in np.argsort(costs[:, i]).tolist() if i not in taken else ():
            if costs[row, i] > _PIECE_GATE:
                break
            if row in found and continues(lines.ends @ tracks[row].direction, found[row], i):
                found[row].append(i)
                break
