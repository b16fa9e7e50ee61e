"""Compare the line tracker with nearest-neighbour association on simulated flights.

    python benchmarks/bench_tracks.py [--seeds 5] [--first-seed 100]

The true lines are disturbed: 2 px of noise at each end, one in ten removed, one false line per frame (eight
in `cluttered`; three in ten removed and two dropouts in `interrupted`). Switches: changes of a conductor's
track per minute in view. Fragments: tracks per conductor and uninterrupted view, 1 at best. Tracked: share of
the lines of a conductor that belong to its longest track.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter, defaultdict
from dataclasses import dataclass, field
from itertools import groupby, pairwise
from typing import TYPE_CHECKING, Protocol

import numpy as np
from measure import conclude

from inspect_pipeline.geometry.attitude import YawPitchRoll
from inspect_pipeline.simulation.options import FaultKind, FlightKind, SimulationOptions
from inspect_pipeline.simulation.truth import simulate_truth
from inspect_pipeline.tracking.camera_motion import CameraMotion
from inspect_pipeline.tracking.tracker import FrameInfo, LineTracker

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from inspect_pipeline.simulation.records import FrameTruth

    Floats = NDArray[np.float64]

_NOISE_PX = 2.0
_SECONDS, _FPS = 40.0, 5.0


@dataclass(frozen=True)
class Case:
    """A kind of flight, and the disturbance of its lines."""

    flight: FlightKind
    faults: tuple[FaultKind, ...] = ()
    missed_share: float = 0.1
    n_false: int = 1


CASES = {
    "easy": Case(FlightKind.PASS_BY),
    "crossing": Case(FlightKind.PASS_BY, (FaultKind.CROSSING_LINE, FaultKind.CONDUCTORS_TOO_CLOSE)),
    "yawing": Case(FlightKind.HOVER),
    "orbiting": Case(FlightKind.ORBIT),
    "cluttered": Case(FlightKind.PASS_BY, n_false=8),
    "interrupted": Case(FlightKind.PASS_BY, (FaultKind.DROPOUT, FaultKind.DROPOUT), missed_share=0.3),
}


class Tracker(Protocol):
    """The interface of both trackers."""

    def update(
        self, frame: FrameInfo, chords: Floats, scores: Floats, motion: Floats | None = None
    ) -> NDArray[np.int32]:
        """Return the track id of each line."""


class NearestNeighbour:
    """Associate lines with those of the previous frame by distance in rho and theta, nearest pair first."""

    def __init__(self) -> None:
        self._ids: list[int] = []
        self._lines = np.zeros((0, 2))
        self._next_id = 0

    def update(
        self,
        frame: FrameInfo,
        chords: Floats,
        scores: Floats,  # noqa: ARG002
        motion: Floats | None = None,  # noqa: ARG002
    ) -> NDArray[np.int32]:
        """Return the track id of each line."""
        lines = self._rho_theta(chords, frame.image_size)
        ids = np.full(len(lines), -1, np.int32)
        costs = np.array([[self._distance(a, b) for b in lines] for a in self._lines]).reshape(-1, len(lines))
        while costs.size and costs.min() < 3:
            row, column = np.unravel_index(costs.argmin(), costs.shape)
            ids[column] = self._ids[row]
            costs[row], costs[:, column] = np.inf, np.inf
        for i in np.flatnonzero(ids < 0):
            ids[i], self._next_id = self._next_id, self._next_id + 1
        self._ids, self._lines = ids.tolist(), lines
        return ids

    @staticmethod
    def _rho_theta(chords: Floats, image_size: tuple[int, int]) -> Floats:
        x, y = chords[:, 2] - chords[:, 0], chords[:, 3] - chords[:, 1]
        theta = np.arctan2(y, x) % np.pi
        middles = (chords[:, :2] + chords[:, 2:]) / 2 - np.array(image_size[::-1]) / 2
        return np.column_stack(((middles * np.column_stack((-np.sin(theta), np.cos(theta)))).sum(1), theta))

    @staticmethod
    def _distance(first: Floats, second: Floats) -> float:
        """Return the distance in units of 20 px and 5 degrees, with theta modulo pi."""
        turn = (second[1] - first[1] + np.pi / 2) % np.pi - np.pi / 2
        is_flipped = abs(second[1] - first[1]) > np.pi / 2
        return float(np.hypot((second[0] * (-1 if is_flipped else 1) - first[0]) / 20, np.degrees(turn) / 5))


@dataclass
class Score:
    """Counts over the flights of a case."""

    seconds_in_view: float = 0.0
    n_switches: int = 0
    n_views: int = 0
    n_fragments: int = 0
    n_lines: int = 0
    n_in_main: int = 0
    n_frames: int = 0
    busy_s: float = 0.0
    histories: dict[str, list[int | None]] = field(default_factory=lambda: defaultdict(list))

    def close_flight(self, fps: float) -> None:
        """Count the tracks of each conductor. None in a history is a frame in which it is out of view."""
        for history in self.histories.values():
            for view in _views(history):
                ids = [track_id for track_id in view if track_id >= 0]
                self.seconds_in_view += len(view) / fps
                self.n_switches += sum(a != b for a, b in pairwise(ids))
                self.n_views += bool(ids)
                self.n_fragments += len(set(ids))
                self.n_lines += len(ids)
                self.n_in_main += max(Counter(ids).values(), default=0)
        self.histories = defaultdict(list)

    def figures(self) -> dict[str, float]:
        """Return the printed figures."""
        return {
            "switches_per_minute": 60 * self.n_switches / self.seconds_in_view,
            "fragments": self.n_fragments / self.n_views,
            "tracked_share": self.n_in_main / self.n_lines,
            "us_per_frame": 1e6 * self.busy_s / self.n_frames,
        }


def _views(history: list[int | None]) -> list[list[int]]:
    """Return the runs of a history without None."""
    runs = groupby(history, lambda track_id: track_id is not None)
    return [[one for one in run if one is not None] for in_view, run in runs if in_view]


def disturbed(frame: FrameTruth, case: Case, rng: np.random.Generator) -> tuple[Floats, list[str | None]]:
    """Return disturbed chords (N, 4) and the conductor of each, None for false lines."""
    chords, names = [], []
    for line in frame.lines:
        if rng.random() >= case.missed_share:
            chords.append(np.concatenate((line.points[0], line.points[-1])) + rng.normal(0, _NOISE_PX, 4))
            names.append(line.conductor_id)
    height, width = frame.image_size
    for _ in range(case.n_false):
        x, y, angle, half = rng.uniform((0, 0, 0, 40), (width, height, np.pi, 250))
        step_x, step_y = half * np.cos(angle), half * np.sin(angle)
        chords.append(np.array((x - step_x, y - step_y, x + step_x, y + step_y)))
        names.append(None)
    order = rng.permutation(len(chords))
    return np.array(chords).reshape(-1, 4)[order], [names[i] for i in order]


def track_flight(tracker: Tracker, case: Case, seed: int, score: Score) -> None:
    """Track one simulated flight."""
    options = SimulationOptions(seconds=_SECONDS, fps=_FPS, seed=seed, flight=case.flight, faults=case.faults)
    truth, rng = simulate_truth(options), np.random.default_rng(seed)
    camera = CameraMotion()
    for frame in truth.frames:
        if frame.frame_idx is None:
            continue
        chords, names = disturbed(frame, case, rng)
        attitude = YawPitchRoll(frame.cam_yaw_deg, frame.cam_pitch_deg, frame.cam_roll_deg)
        motion = camera.update(attitude, frame.log_time_ns, frame.focal_px, frame.image_size)
        started = time.process_time()
        info = FrameInfo(frame.frame_idx, frame.log_time_ns, frame.image_size)
        ids = tracker.update(info, chords, np.ones(len(chords)), motion)
        score.busy_s += time.process_time() - started
        score.n_frames += 1
        found = dict(zip(names, ids.tolist(), strict=True))
        in_view = {line.conductor_id for line in frame.lines}
        for name in in_view | set(score.histories):
            score.histories[name].append(found.get(name, -1) if name in in_view else None)
    score.close_flight(_FPS)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--first-seed", type=int, default=100)
    arguments = parser.parse_args()
    trackers: dict[str, type[Tracker]] = {"ours": LineTracker, "nearest": NearestNeighbour}
    figures: dict[str, float] = {}
    print(
        f"{'case':12}  {'method':8}  {'switches/min':>12}  {'fragments':>9}  {'tracked':>7}  {'us/frame':>8}"
    )
    for name, case in CASES.items():
        for method, make in trackers.items():
            score = Score()
            for seed in range(arguments.first_seed, arguments.first_seed + arguments.seeds):
                track_flight(make(), case, seed, score)
            found = score.figures()
            figures |= {f"{name}_{method}_{key}": value for key, value in found.items()}
            print(
                f"{name:12}  {method:8}  {found['switches_per_minute']:12.2f}  {found['fragments']:9.2f}"
                f"  {found['tracked_share']:7.3f}  {found['us_per_frame']:8.0f}"
            )
    return conclude("tracks", figures, {f"{name}_ours_tracked_share": (0.8, 1.0) for name in CASES})


if __name__ == "__main__":
    raise SystemExit(main())
