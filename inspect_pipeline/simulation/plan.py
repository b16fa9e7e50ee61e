"""Plan a simulated flight: the line with its faults, the path, and the faults of frames over time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from inspect_pipeline.simulation.faults import SeenPart, plant_faults, schedule_faults
from inspect_pipeline.simulation.options import LINE_FAULTS, FaultKind, FlightKind
from inspect_pipeline.simulation.path import SPEED_M_S, Path
from inspect_pipeline.simulation.pose_noise import disturb_pose
from inspect_pipeline.simulation.power_line import SPAN_M, PowerLine, hang_line
from inspect_pipeline.simulation.route import Route
from inspect_pipeline.simulation.scene import Gaze, look, near

if TYPE_CHECKING:
    from collections.abc import Iterator

    from inspect_pipeline.arrays import Floats, Ints, Mask
    from inspect_pipeline.simulation.faults import PlantedFault, TimedFault
    from inspect_pipeline.simulation.options import SimulationOptions
    from inspect_pipeline.simulation.path import DronePose
    from inspect_pipeline.simulation.scene import SimulatedCamera


START_NS = 1_777_887_000 * 10**9  # 2026-05-04 09:30 UTC
POSE_PERIOD_NS = 100_000_000
_FOCAL_SHARE = 0.95  # of the image's width
_FIRST_STRUCTURE = -1
_BEYOND_M = 90.0  # length of the line beyond the last position
_AXIS_STEP_M = 0.1
_RAISED_SHARE = 1.3  # of the width by which a line exceeds the usual one
_USUAL_HALF_M = 1.6
_SWAY_BY_WIND = 4.0  # times as much for each radian by which it swings the conductors


class Shot(NamedTuple):
    """A moment at which the camera takes a picture, or drops it."""

    number: int
    time_ns: int  # since the start
    is_dropped: bool


@dataclass(frozen=True, slots=True, eq=False)
class FlightPlan:
    """A planned flight; `path` and `line` are in metres, in the axes of `route`.

    axis: (N, 3) points every few centimetres along the mean of the conductors without faults. axis_along:
    (N,) their distances along the route.
    azimuth_deg: which way, clockwise from north, x points.
    """

    options: SimulationOptions
    path: Path
    line: PowerLine
    axis: Floats
    axis_along: Floats
    azimuth_deg: float
    planted: tuple[PlantedFault, ...]
    timed: tuple[TimedFault, ...]

    @property
    def takeoff_m(self) -> float:
        """The height of the ground below the first position, from which recorded heights count."""
        return float(self.line.route.ground_m(self.pose(0).position[0]))

    def shots(self) -> Iterator[Shot]:
        """Yield all shots in order."""
        for i in range(max(1, round(self.options.seconds * self.options.fps))):
            time_ns = round(i / self.options.fps * 1e9)
            yield Shot(i, time_ns, self.struck_by(FaultKind.DROPOUT, time_ns) is not None)

    def struck_by(self, kind: FaultKind, time_ns: int) -> TimedFault | None:
        """Return the fault of a kind that is active at a time."""
        return next((f for f in self.timed if f.kind == kind and f.start_s <= time_ns / 1e9 < f.end_s), None)

    def sum_since(self, kind: FaultKind, time_ns: int) -> float:
        """Sum the amounts of the faults of a kind that have started; these last to the end of the flight."""
        return sum(f.amount for f in self.timed if f.kind == kind and f.start_s <= time_ns / 1e9)

    def stamp_ns(self, time_ns: int) -> int:
        """Return the header stamp of the camera's clock at a time."""
        return START_NS + time_ns + round(self.sum_since(FaultKind.CLOCK_STEP, time_ns) * 1e9)

    def pose(self, time_ns: int) -> DronePose:
        """Return the pose of the drone and its camera at a time."""
        return self.path.at(time_ns / 1e9)

    def recorded_pose(self, time_ns: int) -> DronePose:
        """Return the pose that is recorded at a time, with its errors."""
        return disturb_pose(self.pose(time_ns), time_ns, self.options)

    def camera(self, time_ns: int) -> SimulatedCamera:
        """Return the camera at a time, rolled where it slipped in its mount (the pose is not)."""
        pose = self.pose(time_ns)
        roll_rad = self.sum_since(FaultKind.ORIENTATION_JUMP, time_ns)
        return look(
            np.array(pose.position),
            Gaze(pose.yaw_rad, pose.pitch_rad, roll_rad),
            _FOCAL_SHARE * self.options.image_size[1],
            self.options.image_size,
        )

    def position_times_ns(self) -> list[int]:
        """Return when positions are recorded, up to the last picture."""
        *_, last = self.shots()
        times_ns = range(0, last.time_ns + 1, POSE_PERIOD_NS)
        return [time_ns for time_ns in times_ns if not self.struck_by(FaultKind.GPS_GAP, time_ns)]

    def axis_seen(self, camera: SimulatedCamera) -> Ints:
        """Return the indices of the points of the axis that a camera sees."""
        window = near(camera, self.axis)
        seen: Ints = np.flatnonzero(camera.sees(*camera.project(self.axis[window])))
        return seen + int(window.start)

    def shares_of_spans(self, is_seen: Mask) -> Floats:
        """Return (n_spans,): the share of each span's axis where `is_seen` (N,) is True."""
        numbers = self.line.span_numbers(self.axis_along)
        shares: Floats = np.bincount(numbers, is_seen) / np.bincount(numbers)
        return shares

    def span_id(self, span: int) -> str:
        """Return the name of the span after structure number `span`, both counted from 0."""
        return f"{self.structure_id(span)}-{self.structure_id(span + 1)}"

    def structure_id(self, structure: int) -> str:
        """Return the name of a structure."""
        return f"S{structure + 1:02d}"


def plan_flight(options: SimulationOptions) -> FlightPlan:
    """Plan a flight by its options. Raises ValueError for an impossible line."""
    rng = np.random.default_rng([options.seed, 1])
    n_structures = options.n_structures or _n_passed(options)
    wind_rad = float(np.deg2rad(options.wind_deg))
    route = Route(_corner_m(options, n_structures), float(np.deg2rad(options.corner_deg)), options.hills_m)
    line = hang_line(
        _FIRST_STRUCTURE,
        n_structures,
        options.n_phases,
        options.n_bundle,
        options.n_circuits,
        wind_rad,
        route,
    )
    raised_m = _RAISED_SHARE * max(0.0, line.half_width_m - _USUAL_HALF_M)
    phases, sway = rng.uniform(0, 2 * np.pi, 4), 1 + _SWAY_BY_WIND * wind_rad
    path = Path(options.flight, options.seconds, raised_m, phases, sway, route)
    azimuth_deg = float(rng.uniform(0, 360))
    timed = schedule_faults(options.faults, options.seconds, options.fps, rng)
    clean = FlightPlan(options, path, line, *_axis(line), azimuth_deg, (), tuple(timed))
    if not set(options.faults) & set(LINE_FAULTS):
        return clean
    faulty, planted = plant_faults(line, options.faults, _seen_parts(clean), rng)
    return replace(clean, line=faulty, planted=tuple(planted))


def _n_passed(options: SimulationOptions) -> int:
    """Return how many structures a line needs to be longer than the flight."""
    last_m = _BEYOND_M + (_passed_m(options) or SPAN_M)
    return int(np.ceil(last_m / SPAN_M)) + 1 - _FIRST_STRUCTURE


def _passed_m(options: SimulationOptions) -> float:
    passes = options.flight in {FlightKind.PASS_BY, FlightKind.LOSS}
    return SPEED_M_S * options.seconds if passes else 0.0


def _corner_m(options: SimulationOptions, n_structures: int) -> float:
    """Return how far along the structure is at which the line may turn.

    It is the one nearest to the middle of what is flown by, but ahead of the start, and not the last.
    """
    middle = max(1, round(_passed_m(options) / 2 / SPAN_M))
    return min(middle, _FIRST_STRUCTURE + n_structures - 2) * SPAN_M


def _axis(line: PowerLine) -> tuple[Floats, Floats]:
    coarse = np.mean([conductor.points for conductor in line.conductors], axis=0)
    along = np.arange(line.along[0], line.along[-1], _AXIS_STEP_M)
    return np.column_stack([np.interp(along, line.along, column) for column in coarse.T]), along


def _seen_parts(plan: FlightPlan) -> list[SeenPart]:
    """Return what any picture shows of each span's axis."""
    is_seen = np.zeros(len(plan.axis), bool)
    for shot in plan.shots():
        if not shot.is_dropped:
            is_seen[plan.axis_seen(plan.camera(shot.time_ns))] = True
    numbers = plan.line.span_numbers(plan.axis_along)
    parts = []
    for span, share in enumerate(plan.shares_of_spans(is_seen).tolist()):
        seen = (plan.axis_along[is_seen & (numbers == span)] - plan.line.structures_along[span]) / SPAN_M
        parts.append(
            SeenPart(share, float(seen[0]), float(seen[-1])) if len(seen) else SeenPart(0.0, 0.0, 0.0)
        )
    return parts
