"""Plant faults into a simulated flight: into its line, or into its frames and messages at some times."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from inspect_pipeline.simulation.options import FRAME_FAULTS, LINE_FAULTS, FaultKind
from inspect_pipeline.simulation.power_line import SPAN_M, cross, move_stretch, remove_stretch

if TYPE_CHECKING:
    from collections.abc import Sequence

    from inspect_pipeline.arrays import Floats
    from inspect_pipeline.simulation.power_line import PowerLine


_MIDDLE_SHARE = (0.3, 0.7)  # of a span: range of positions of faults
_GAP_M = (3.0, 5.0)
_EXTRA_SAG_M = (1.4, 2.4)
_CLOSE_SHARE = 0.85  # by which the distance of two conductors is reduced
_CLOSE_HALF = 0.3  # of a span: half of the stretch along which it is
_MAX_NEIGHBOUR_M = 4.0
_CROSSING_RAD = np.deg2rad((40, 90))
_STRUCK_S = (2.0, 4.0)  # duration of faults of frames
_AMOUNTS = {FaultKind.CLOCK_STEP: (0.7, 5.0), FaultKind.ORIENTATION_JUMP: (0.4, 0.6)}  # s, rad
_QUIET_SHARE = 0.12  # of the flight, at its start and end, has no fault


@dataclass(frozen=True, slots=True, eq=False)
class PlantedFault:
    """A fault of the line; `evidence` (M, 3) are the points where it shows, whether present or missing."""

    kind: FaultKind
    span: int
    conductor_ids: tuple[str, ...]
    evidence: Floats


class SeenPart(NamedTuple):
    """What a flight shows of a span: the share of it, and from where to where, as shares of its length."""

    share: float
    first: float
    last: float


class TimedFault(NamedTuple):
    """A fault of frames or messages from one time to another, in s.

    `amount` is in s for a clock step, in rad for an orientation jump; both last to the end of the flight.
    """

    kind: FaultKind
    start_s: float
    end_s: float
    amount: float


def plant_faults(
    line: PowerLine, kinds: Sequence[FaultKind], seen: Sequence[SeenPart], rng: np.random.Generator
) -> tuple[PowerLine, list[PlantedFault]]:
    """Plant the line faults among `kinds` into the spans that are best visible, near the middle of a span.

    seen: what the flight shows of each span.
    """
    shares = np.array([part.share for part in seen])
    spans = np.argsort(-np.round(shares, 1) + 0.01 * rng.random(len(shares)))
    planted = []
    for i, kind in enumerate(kind for kind in kinds if kind in LINE_FAULTS):
        span = int(spans[i % len(spans)])
        line, fault = _plant(line, kind, span, _middle_of(seen[span]), rng)
        planted.append(fault)
    return line, planted


def _middle_of(seen: SeenPart) -> tuple[float, float]:
    """Return the range of positions of faults in a span: the middle of what the flight shows, and its own."""
    margin = (seen.last - seen.first) / 4
    shown = seen.first + margin, seen.last - margin
    low, high = max(shown[0], _MIDDLE_SHARE[0]), min(shown[1], _MIDDLE_SHARE[1])
    return (low, high) if low < high else shown


def _plant(
    line: PowerLine, kind: FaultKind, span: int, middle: tuple[float, float], rng: np.random.Generator
) -> tuple[PowerLine, PlantedFault]:
    from_m = float(line.structures_along[span])
    if kind == FaultKind.CROSSING_LINE:
        changed = cross(line, from_m + rng.uniform(*middle) * SPAN_M, rng.uniform(*_CROSSING_RAD))
        foreign = changed.foreign[-1]
        return changed, PlantedFault(kind, span, (foreign.conductor_id,), foreign.points)
    numbers = _with_neighbours(line) if kind == FaultKind.CONDUCTORS_TOO_CLOSE else None
    numbers = numbers or list(range(max(1, len(line.conductors) - 2)))
    number = numbers[int(rng.integers(len(numbers)))]
    conductor, neighbour = line.conductors[number : number + 2]
    name, points = conductor.conductor_id, conductor.points
    along = (line.along - from_m) / SPAN_M
    is_in_span = (along >= 0) & (along <= 1)
    if kind == FaultKind.SAG_OUTLIER:
        drop = np.where(is_in_span, rng.uniform(*_EXTRA_SAG_M) * 4 * along * (1 - along), 0.0)
        shift = drop[:, np.newaxis] * (0.0, 0.0, -1.0)
        changed = move_stretch(line, name, shift)
        evidence = changed[name].points[drop > drop.max() / 2]
        return changed, PlantedFault(kind, span, (name,), evidence)
    if kind == FaultKind.CONDUCTORS_TOO_CLOSE:
        ahead = along - np.clip(sum(middle) / 2, _CLOSE_HALF, 1 - _CLOSE_HALF)
        bulge = np.where(np.abs(ahead) < _CLOSE_HALF, np.cos(np.pi / 2 * ahead / _CLOSE_HALF) ** 2, 0.0)
        shift = (_CLOSE_SHARE * bulge)[:, np.newaxis] * (neighbour.points - points)
        changed = move_stretch(line, name, shift)
        evidence = changed[name].points[_CLOSE_SHARE * bulge > 0.5]
        return changed, PlantedFault(kind, span, (name, neighbour.conductor_id), evidence)
    first, last = _absent_stretch(kind, middle, rng)
    changed = remove_stretch(line, name, from_m + first * SPAN_M, from_m + last * SPAN_M)
    return changed, PlantedFault(kind, span, (name,), points[(along >= first) & (along <= last)])


def _with_neighbours(line: PowerLine) -> list[int]:
    """Return the numbers of the conductors whose next one is of another phase, and not far away."""
    pairs = zip(line.conductors, line.conductors[1:-1], strict=False)  # the last is the neutral
    return [
        number
        for number, (one, other) in enumerate(pairs)
        if one.conductor_id[:2] != other.conductor_id[:2]
        and np.linalg.norm(one.points[0] - other.points[0]) < _MAX_NEIGHBOUR_M
    ]


def _absent_stretch(
    kind: FaultKind, middle: tuple[float, float], rng: np.random.Generator
) -> tuple[float, float]:
    """Return the missing part of a conductor as shares of the span: all, the end, or a gap."""
    if kind == FaultKind.MISSING_CONDUCTOR:
        return 0.0, 1.0
    start = rng.uniform(*middle)
    if kind == FaultKind.BROKEN_CONDUCTOR:
        return start, 1.0
    return start, start + rng.uniform(*_GAP_M) / SPAN_M


def schedule_faults(
    kinds: Sequence[FaultKind], seconds: float, fps: float, rng: np.random.Generator
) -> list[TimedFault]:
    """Schedule the faults of frames and messages among `kinds`, one after the other."""
    struck = [kind for kind in kinds if kind in FRAME_FAULTS]
    if not struck:
        return []
    start_s, end_s = _QUIET_SHARE * seconds, (1 - _QUIET_SHARE) * seconds
    slot_s = (end_s - start_s) / len(struck)
    timed = []
    for i, kind in enumerate(struck):
        length_s = min(max(rng.uniform(*_STRUCK_S), 4 / fps), 0.7 * slot_s)
        begins_s = start_s + i * slot_s + rng.uniform(0, slot_s - length_s)
        least, most = _AMOUNTS.get(kind, (0.0, 0.0))
        timed.append(
            TimedFault(kind, begins_s, begins_s + length_s, rng.choice((-1, 1)) * rng.uniform(least, most))
        )
    return timed
