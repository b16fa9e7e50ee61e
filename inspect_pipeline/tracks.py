"""Lines followed over the frames of a camera.

    tracker = LineTracker()
    for frame in frames:
        track_ids = tracker.update(moment, chords, scores, motion)     # one for each line
    tracks = tracker.finish()                                          # the ones that were confirmed

A line is its direction and its offset from the middle of the image (theta and rho), and how far it extends. A
track moves on at the speed it had, after the camera's own turn is undone; predictions and lines are matched
by the Hungarian algorithm. A track that finds no line coasts for a while before it ends.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Scores = NDArray[np.floating]

_DISTANCE_SHARE = 20 / 1280  # of the image's longer side: one unit of cost,
_ANGLE_RAD = np.radians(5)  # as is this,
_GAP_SHARE = 200 / 1280  # and this, between the ends of a line and of the track
_GATE = 3.0
_PIECE_GATE = 1.0  # for further pieces of a line that is found already
_OVERLAP_SHARE = 0.2  # of a piece, at most, lies beside the other pieces
_POSITION_GAIN, _SPEED_GAIN = 0.6, 0.3  # of what a line differs from the prediction
_CONFIRMED_FRAMES = 3
_COAST_FRAMES, _TENTATIVE_COAST_FRAMES = 10, 1
_COAST_S = 5.0
_FORESIGHT_S = 1.0  # no speed is trusted for longer


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
    """State: angle (rad, unwrapped) and offset (px) of the line, their speeds, extent along it (px)."""

    track_id: int
    state: Floats  # angle, offset
    speed: Floats
    extent: tuple[float, float]
    first: Moment
    last: Moment
    n_frames: int = 1
    n_missed: int = 0  # since it was last found
    n_coasted: int = 0
    sums: Floats = field(default_factory=lambda: np.zeros(3))  # of score, angle, offset

    @property
    def is_confirmed(self) -> bool:
        return self.n_frames >= _CONFIRMED_FRAMES

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
        self, moment: Moment, chords: Floats, scores: Scores, motion: Floats | None = None
    ) -> NDArray[np.int32]:
        """The track of each line of a frame.

        chords: (N, 4) x1, y1, x2, y2 in px; scores: (N,). motion: (3, 3) from the pixels of the frame before
        to those of this one, as the camera turned; None where that is not known. Lines of tracks that
        `finish` does not name belong to none.
        """
        self._advance(moment, motion)
        lines = _Lines.of(chords, moment.image_size)
        track_ids = np.full(len(chords), -1, np.int32)
        found = self._match(lines, moment.image_size)
        for track in self._tracks:
            pieces = found.get(track.track_id)
            if pieces is None:
                track.n_missed += 1
            else:
                track_ids[pieces] = track.track_id
                _correct(track, moment, lines, pieces, float(scores[pieces].max()))
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
        for track in self._tracks:
            if motion is not None:
                _turn(track, motion, moment.image_size)
            unseen_s = (moment.time_ns - track.last.time_ns) / 1e9 - elapsed_s
            trusted_s = min(elapsed_s, max(0.0, _FORESIGHT_S - unseen_s))
            track.state = track.state + trusted_s * track.speed

    def _match(self, lines: _Lines, image_size: tuple[int, int]) -> dict[int, NDArray[np.int64]]:
        """The lines of each track that is found, by its id."""
        if not self._tracks or not len(lines.angles):
            return {}
        costs = _costs(self._tracks, lines, image_size)
        # A line that is left alone costs as much as the worst that is allowed.
        padded = np.hstack((np.minimum(costs, 2 * _GATE), np.full((len(costs), len(costs)), _GATE)))
        rows, columns = linear_sum_assignment(padded)
        found = {
            row: [column]
            for row, column in zip(rows.tolist(), columns.tolist(), strict=True)
            if column < costs.shape[1] and costs[row, column] < _GATE
        }
        _add_pieces(found, costs, lines, self._tracks)
        return {self._tracks[row].track_id: np.array(pieces) for row, pieces in found.items()}

    def _begin(self, moment: Moment, lines: _Lines, i: int, score: float) -> int:
        state = np.array([lines.angles[i], lines.offset(i)])
        track = _Track(
            track_id=self._next_id,
            state=state,
            speed=np.zeros(2),
            extent=lines.extent(np.array([i]), state[0]),
            first=moment,
            last=moment,
            sums=np.array([score, *state]),
        )
        self._tracks.append(track)
        self._next_id += 1
        return track.track_id

    def _end_lost(self, time_ns: int) -> None:
        ended = [track for track in self._tracks if track.has_ended(time_ns)]
        self._ended += [track.to_row() for track in ended if track.is_confirmed]
        self._tracks = [track for track in self._tracks if not track.has_ended(time_ns)]


@dataclass(frozen=True, slots=True, eq=False)
class _Lines:
    """The lines of a frame: ends (N, 2, 2) px from the middle of the image, angles (N,) of their chords."""

    ends: Floats
    angles: Floats

    @classmethod
    def of(cls, chords: Floats, image_size: tuple[int, int]) -> _Lines:
        height, width = image_size
        ends = np.asarray(chords, np.float64).reshape(-1, 2, 2) - (width / 2, height / 2)
        along = ends[:, 1] - ends[:, 0]
        return cls(ends, np.arctan2(along[:, 1], along[:, 0]))

    @property
    def middles(self) -> Floats:
        middles: Floats = self.ends.mean(axis=1)
        return middles

    def offset(self, i: int) -> float:
        return float(self.middles[i] @ _normal(self.angles[i]))

    def extent(self, pieces: NDArray[np.int64], angle: float) -> tuple[float, float]:
        """From where to where pieces of a line lie along a direction."""
        along = self.ends[pieces].reshape(-1, 2) @ (np.cos(angle), np.sin(angle))
        return float(along.min()), float(along.max())


def _normal(angle: float) -> Floats:
    return np.array([-np.sin(angle), np.cos(angle)])


def _costs(tracks: list[_Track], lines: _Lines, image_size: tuple[int, int]) -> Floats:
    """(T, N): how far each line is from where each track is expected, in units of the gate."""
    longer_px = max(image_size)
    angles, offsets = np.array([track.state for track in tracks]).T
    extents = np.array([track.extent for track in tracks])
    direction = np.column_stack((np.cos(angles), np.sin(angles)))
    normal = np.column_stack((-direction[:, 1], direction[:, 0]))
    distances = normal @ lines.middles.T - offsets[:, np.newaxis]
    turns = _half_turned(lines.angles[np.newaxis] - angles[:, np.newaxis])
    along = np.einsum("ti,nei->tne", direction, lines.ends)
    lows, highs = along.min(axis=2), along.max(axis=2)
    gaps = np.maximum(0, np.maximum(lows - extents[:, 1:], extents[:, :1] - highs))
    costs: Floats = np.sqrt(
        (distances / (_DISTANCE_SHARE * longer_px)) ** 2
        + (turns / _ANGLE_RAD) ** 2
        + (gaps / (_GAP_SHARE * longer_px)) ** 2
    )
    return costs


def _half_turned(angles: Floats) -> Floats:
    """The same directions of lines, within -pi/2 <= angle < pi/2."""
    turned: Floats = (angles + np.pi / 2) % np.pi - np.pi / 2
    return turned


def _add_pieces(found: dict[int, list[int]], costs: Floats, lines: _Lines, tracks: list[_Track]) -> None:
    """Give lines that no track has to tracks that they continue, nearest first."""
    taken = {piece for pieces in found.values() for piece in pieces}
    for i in range(costs.shape[1]):
        if i in taken:
            continue
        for row in np.argsort(costs[:, i]).tolist():
            if costs[row, i] > _PIECE_GATE:
                break
            if row in found and _continues(lines, found[row], i, tracks[row].state[0]):
                found[row].append(i)
                break


def _continues(lines: _Lines, pieces: list[int], i: int, angle: float) -> bool:
    """Whether a line lies before, behind or between the pieces instead of beside them."""
    low, high = lines.extent(np.array([i]), angle)
    others = [lines.extent(np.array([piece]), angle) for piece in pieces]
    beside_px = sum(max(0.0, min(high, end) - max(low, start)) for start, end in others)
    return beside_px <= _OVERLAP_SHARE * (high - low)


def _correct(track: _Track, moment: Moment, lines: _Lines, pieces: NDArray[np.int64], score: float) -> None:
    """Draw a track towards the line that was found."""
    ends = lines.ends[pieces].reshape(-1, 2)
    along = ends @ (np.cos(track.state[0]), np.sin(track.state[0]))
    first, last = ends[along.argmin()], ends[along.argmax()]
    turn = float(_half_turned(np.arctan2(*(last - first)[::-1]) - track.state[0]))
    angle = track.state[0] + turn
    difference = np.array([turn, (first + last) / 2 @ _normal(angle) - track.state[1]])
    elapsed_s = max((moment.time_ns - track.last.time_ns) / 1e9, 1e-3)
    is_second = track.n_frames == 1
    track.state = track.state + (1.0 if is_second else _POSITION_GAIN) * difference
    track.speed = track.speed + (1.0 if is_second else _SPEED_GAIN) * difference / elapsed_s
    track.extent = lines.extent(pieces, float(track.state[0]))
    track.n_coasted += track.n_missed
    track.n_missed = 0
    track.n_frames += 1
    track.last = moment
    track.sums += (score, *track.state)


def _turn(track: _Track, motion: Floats, image_size: tuple[int, int]) -> None:
    """Move a track's line as the camera's turn moves its pixels; what is turned out of sight stays."""
    height, width = image_size
    angle, offset = track.state
    direction = np.array([np.cos(angle), np.sin(angle)])
    ends = offset * _normal(angle) + np.outer(track.extent, direction) + (width / 2, height / 2)
    moved = np.column_stack((ends, np.ones(2))) @ motion.T
    if np.any(moved[:, 2] < 0.1):
        return
    first, last = moved[:, :2] / moved[:, 2:] - (width / 2, height / 2)
    turn = float(_half_turned(np.arctan2(*(last - first)[::-1]) - angle))
    track.state = np.array([angle + turn, (first + last) / 2 @ _normal(angle + turn)])
    along = np.array([first, last]) @ (np.cos(angle + turn), np.sin(angle + turn))
    track.extent = (float(along.min()), float(along.max()))
