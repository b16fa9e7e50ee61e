"""The drawn power line: poles in a row, and the conductors between them, which hang as catenaries.

Structure k stands k * SPAN_M along the route of the line. On slopes, too, a conductor sags below the straight
line between its ends.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.optimize import brentq

from inspect_pipeline.simulation.route import Route

if TYPE_CHECKING:
    from inspect_pipeline.arrays import Floats, Ints, Mask


SPAN_M = 55.0
POLE_HEIGHT_M = 12.5
SAMPLE_M = 0.25
_SAG_M = 1.1
_SPACING_M, _BUNDLE_M = 1.6, 0.4
_ARM_M, _RAISED_M = 12.3, 0.6  # height of the phases; the middle one of three is higher
_CIRCUIT_HALF_M, _TOP_ARM_M, _ARM_APART_M = 3.0, 15.0, 2.2  # of two circuits
_NEUTRAL_Y_Z_M = (0.35, 9.2)
_PHASE_DIAMETER_M, _NEUTRAL_DIAMETER_M = 0.045, 0.06
_FOREIGN_Z_M, _FOREIGN_HALF_M, _FOREIGN_DIAMETER_M = 6.5, 40.0, 0.045


class Attachment(NamedTuple):
    """Where one conductor is attached to every structure: how far left of it, and how high above its foot."""

    conductor_id: str
    left_m: float
    up_m: float
    diameter_m: float


class Structure(NamedTuple):
    """A pole or tower: its foot (3,), and the vector (2,) of a metre to the left along its arm."""

    foot: Floats
    arm: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Conductor:
    """Points (N, 3) along a conductor; is_there (N,) is False where it is missing."""

    conductor_id: str
    points: Floats
    is_there: Mask
    diameter_m: float


@dataclass(frozen=True, slots=True, eq=False)
class PowerLine:
    """Structures by number, from `first`; conductors sampled every SAMPLE_M from the first to the last.

    along (N,): distance along the route of each of a conductor's points. foreign: conductors of other lines
    that cross it.
    """

    route: Route
    first: int
    n_structures: int
    along: Floats
    conductors: tuple[Conductor, ...]
    foreign: tuple[Conductor, ...] = ()

    @property
    def structures_along(self) -> Floats:
        """The distances of the structures along the route."""
        return np.arange(self.first, self.first + self.n_structures, dtype=np.float64) * SPAN_M

    @property
    def structures(self) -> tuple[Structure, ...]:
        """The structures from the first to the last."""
        return tuple(_stand(self.route, along) for along in self.structures_along.tolist())

    @property
    def half_width_m(self) -> float:
        """The distance from the axis of the line to its outermost conductor."""
        return float(max(np.abs(conductor.points[0, 1]) for conductor in self.conductors))

    def __getitem__(self, conductor_id: str) -> Conductor:
        return next(c for c in self.conductors if c.conductor_id == conductor_id)

    def span_numbers(self, along: Floats) -> Ints:
        """Return the number of the span, from 0, at each distance along the route."""
        numbers = np.floor(along / SPAN_M).astype(np.int64) - self.first
        return np.clip(numbers, 0, self.n_structures - 2)


def hang_line(  # noqa: PLR0917 - numbers of one line
    first: int,
    n_structures: int,
    n_phases: int,
    n_bundle: int,
    n_circuits: int = 1,
    wind_rad: float = 0.0,
    route: Route = Route(),  # noqa: B008 - immutable
) -> PowerLine:
    """Return a line without faults; raises ValueError for less than two structures, a phase or a wire."""
    if n_structures < 2 or n_phases < 1 or n_bundle < 1:
        raise ValueError("a line has at least two structures, a phase and a wire in its bundle")
    n_samples = round((n_structures - 1) * SPAN_M / SAMPLE_M) + 1
    along = first * SPAN_M + np.arange(n_samples, dtype=np.float64) * SAMPLE_M
    line = PowerLine(route, first, n_structures, along, ())
    number = line.span_numbers(along)
    share = (along / SPAN_M - first - number)[:, np.newaxis]
    feet, arms = (np.array(column) for column in zip(*line.structures, strict=True))
    foot = feet[number] * (1 - share) + feet[number + 1] * share
    arm = arms[number] * (1 - share) + arms[number + 1] * share
    left = np.diff(feet[:, :2], axis=0)[number] @ np.array([[0, 1], [-1, 0]]) / SPAN_M
    drop = _catenary_drop(share)
    swing = np.column_stack((np.sin(wind_rad) * drop * left, -np.cos(wind_rad) * drop))
    conductors = [
        Conductor(
            place.conductor_id,
            foot + np.column_stack((place.left_m * arm, np.full(len(along), place.up_m))) + swing,
            np.ones(len(along), bool),
            place.diameter_m,
        )
        for place in _attachments(n_phases, n_bundle, n_circuits)
    ]
    return replace(line, conductors=tuple(conductors))


def _stand(route: Route, along: float) -> Structure:
    x, y = route.places(along).tolist()
    return Structure(np.array([x, y, float(route.ground_m(x))]), route.arm(along))


def _attachments(n_phases: int, n_bundle: int, n_circuits: int) -> list[Attachment]:
    """Phases L1, L2, ... from right to left, each of wires a, b, ...; the neutral N below them.

    With two circuits the phases of each hang below each other, those of the first to the right.
    """
    spacing_m = _SPACING_M + 2 * _BUNDLE_M * (n_bundle - 1)
    places = []
    for number in range(n_circuits * n_phases):
        circuit, phase = divmod(number, n_phases)
        y, z = (phase - (n_phases - 1) / 2) * spacing_m, _ARM_M
        if n_circuits > 1:
            y, z = (2 * circuit - 1) * _CIRCUIT_HALF_M, _TOP_ARM_M - phase * _ARM_APART_M
        elif n_phases == 3 and phase == 1:
            z += _RAISED_M
        for wire in range(n_bundle):
            name = f"L{number + 1}" + (chr(ord("a") + wire) if n_bundle > 1 else "")
            shift = (wire - (n_bundle - 1) / 2) * _BUNDLE_M
            places.append(Attachment(name, y + shift, z, _PHASE_DIAMETER_M))
    return [*places, Attachment("N", *_NEUTRAL_Y_Z_M, _NEUTRAL_DIAMETER_M)]


def _catenary_drop(along: Floats) -> Floats:
    """Return the sag of a conductor below its ends, at shares of the span from 0 to 1."""
    half_m = SPAN_M / 2
    # z = a cosh(x / a) sags by a (cosh(L / 2a) - 1), which decreases with a.
    a = brentq(lambda a: a * (np.cosh(half_m / a) - 1) - _SAG_M, half_m, 1e3 * SPAN_M)
    drop: Floats = a * (np.cosh(half_m / a) - np.cosh((along * SPAN_M - half_m) / a))
    return drop


def remove_stretch(line: PowerLine, conductor_id: str, from_m: float, to_m: float) -> PowerLine:
    """Return the line without a conductor between two distances along it."""
    conductor = line[conductor_id]
    is_there = conductor.is_there & ~((line.along >= from_m) & (line.along <= to_m))
    return _with(line, replace(conductor, is_there=is_there))


def move_stretch(line: PowerLine, conductor_id: str, shift: Floats) -> PowerLine:
    """Return the line with the points of a conductor moved by (N, 3)."""
    conductor = line[conductor_id]
    return _with(line, replace(conductor, points=conductor.points + shift))


def _with(line: PowerLine, changed: Conductor) -> PowerLine:
    same = changed.conductor_id
    return replace(line, conductors=tuple(changed if c.conductor_id == same else c for c in line.conductors))


def cross(line: PowerLine, along: float, angle_rad: float) -> PowerLine:
    """Return the line with another one that crosses below it, level and at an angle, at a distance along."""
    x, y = line.route.places(along).tolist()
    angle_rad += float(line.route.headings_rad(along))
    way = np.arange(-_FOREIGN_HALF_M, _FOREIGN_HALF_M, SAMPLE_M)
    z = float(line.route.ground_m(x)) + _FOREIGN_Z_M
    points = np.column_stack((x + way * np.cos(angle_rad), y + way * np.sin(angle_rad), np.full_like(way, z)))
    name = f"X{len(line.foreign) + 1}"
    foreign = Conductor(name, points, np.ones(len(points), bool), _FOREIGN_DIAMETER_M)
    return replace(line, foreign=(*line.foreign, foreign))
