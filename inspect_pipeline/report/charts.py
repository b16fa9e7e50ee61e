"""Strips of a report over the time of the flight: coverage, conductors, sharpness, height above ground."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from inspect_pipeline.report.words import clock, duration, nice_step, quantity

if TYPE_CHECKING:
    from collections.abc import Sequence

    from inspect_pipeline.arrays import Ints
    from inspect_pipeline.report.data import FlightData, Row

LEFT, RIGHT, STRIP_HEIGHT, _N_COLUMNS = 96.0, 1000.0, 44.0, 450  # in units of the drawing
_COLUMN = (RIGHT - LEFT) / _N_COLUMNS
# From the least to the most that a column can show; what is worse hides what is better.
_STATES = ("lines", "bare", "poor", "none")
STATE_NAMES = {
    "lines": "lines found",
    "bare": "no lines",
    "poor": "frame not usable",
    "none": "no frames",
}
_POOR_KINDS = frozenset({"blurred_frames", "dark_frames", "overexposed_frames"})
_STEPS_S, _MAX_TICKS = (1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600), 8


@dataclass(frozen=True, slots=True)
class Bar:
    """A stretch of time of one state."""

    x: float
    width: float
    state: str
    title: str


@dataclass(frozen=True, slots=True)
class Curve:
    """A number over time: pieces of a polyline in the strip, and the values at its lower and upper edge."""

    name: str
    unit: str
    pieces: list[str]
    low: str
    high: str


@dataclass(frozen=True, slots=True)
class Tick:
    """A mark on the axis, or an anomaly from `x` over `width`."""

    x: float
    label: str
    width: float = 0.0
    kind: str = ""
    target: str = ""
    title: str = ""


@dataclass(frozen=True, slots=True)
class Timeline:
    """All strips over one axis of time."""

    bars: list[Bar]
    curves: list[Curve]
    axis: list[Tick]
    anomalies: list[Tick] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class _Time:
    """The axis: nanoseconds to the drawing."""

    start_ns: int
    length_ns: int

    def x(self, time_ns: int) -> float:
        share = (time_ns - self.start_ns) / self.length_ns
        return LEFT + (RIGHT - LEFT) * min(max(share, 0.0), 1.0)

    def columns(self, times_ns: Ints) -> Ints:
        found: Ints = np.clip((times_ns - self.start_ns) * _N_COLUMNS // self.length_ns, 0, _N_COLUMNS - 1)
        return found


def draw_timeline(data: FlightData) -> Timeline | None:
    """Lay out the strips; None for a flight without frames."""
    if not data.frames:
        return None
    times_ns = np.array([row["log_time_ns"] for row in data.frames], np.int64)
    time = _Time(int(times_ns[0]), max(int(times_ns[-1] - times_ns[0]), 1))
    columns = time.columns(times_ns)
    curves = (
        _curve("Conductors", "", columns, [row["n_conductors"] for row in data.frames]),
        _curve("Sharpness", "", columns, [row["sharpness"] for row in data.frames]),
        _curve("Height", "m", columns, [row["height_m"] for row in data.frames]),
    )
    return Timeline(
        bars=_bars(_column_states(data, columns, time), time),
        curves=[curve for curve in curves if curve is not None],
        axis=_axis(time),
        anomalies=[_to_tick(row, number, time) for number, row in enumerate(data.anomalies, 1)],
    )


def _to_tick(row: Row, number: int, time: _Time) -> Tick:
    x = time.x(row["start_ns"])
    target, width = f"finding-{row['anomaly_id']}", max(time.x(row["end_ns"]) - x, 3.0)
    return Tick(x, str(number), width, row["priority"], target, row["reason"])


def _column_states(data: FlightData, columns: Ints, time: _Time) -> Ints:
    """Return the index in _STATES of every column: its worst frame, else the last frame before it."""
    frames = np.array([_frame_state(row) for row in data.frames])
    by_column = np.full(_N_COLUMNS, -1)
    np.maximum.at(by_column, columns, frames)
    last_known = np.maximum.accumulate(np.where(by_column >= 0, np.arange(_N_COLUMNS), 0))
    states: Ints = by_column[last_known]
    for row in data.anomalies:
        if row["kind"] in _POOR_KINDS:
            first, last = time.columns(np.array([row["start_ns"], row["end_ns"]]))
            states[first : last + 1] = np.maximum(states[first : last + 1], _STATES.index("poor"))
    for gap in data.gaps:
        if gap["kind"] == "frame":
            first, last = time.columns(np.array([gap["start_ns"], gap["end_ns"]]))
            states[first + 1 : last] = _STATES.index("none")
    return states


def _frame_state(row: Row) -> int:
    if row["status"] != "ok":
        return _STATES.index("poor")
    return _STATES.index("lines" if row["n_lines"] else "bare")


def _bars(states: Ints, time: _Time) -> list[Bar]:
    """Return one bar for each run of columns of a state."""
    edges = [0, *(np.flatnonzero(np.diff(states)) + 1).tolist(), _N_COLUMNS]
    bars = []
    for first, stop in pairwise(edges):
        start_ns, stop_ns = (time.start_ns + time.length_ns * edge // _N_COLUMNS for edge in (first, stop))
        state = _STATES[int(states[first])]
        title = f"{clock(start_ns)}, {duration((stop_ns - start_ns) / 1e9)}: {STATE_NAMES[state]}"
        bars.append(Bar(LEFT + first * _COLUMN, (stop - first) * _COLUMN, state, title))
    return bars


def _curve(name: str, unit: str, columns: Ints, values: Sequence[float | None]) -> Curve | None:
    """Return the medians of the columns as a curve; None without any value."""
    numbers = np.array([np.nan if value is None else value for value in values], np.float64)
    known = np.isfinite(numbers)
    if not known.any():
        return None
    places, starts = np.unique(columns[known], return_index=True)
    medians = np.array([np.median(part) for part in np.split(numbers[known], starts[1:])])
    low, high = min(0.0, float(medians.min())), float(medians.max()) or 1.0
    x = LEFT + (places + 0.5) * _COLUMN
    y = STRIP_HEIGHT - 3 - (medians - low) / max(high - low, 1e-9) * (STRIP_HEIGHT - 8)
    steps = np.diff(places)
    breaks = np.flatnonzero(steps > max(3.0, 3 * float(np.median(steps)) if len(steps) else 3.0)) + 1
    pieces = np.split(np.column_stack((x, y)), breaks)
    drawn = [" ".join(f"{a:.1f},{b:.1f}" for a, b in piece.tolist()) for piece in pieces if len(piece) > 1]
    return Curve(name, unit, drawn, quantity(low, unit), quantity(high, unit))


def _axis(time: _Time) -> list[Tick]:
    """Return ticks at round seconds since the first frame, labelled with the time of day."""
    length_s = time.length_ns / 1e9
    step_s = next(
        (step for step in _STEPS_S if length_s / step <= _MAX_TICKS), 3600 * nice_step(length_s / 3600, 6)
    )
    first_s = -(-time.start_ns // int(step_s * 1e9)) * step_s
    n_ticks = int((time.start_ns / 1e9 + length_s - first_s) // step_s) + 1
    moments = [int((first_s + i * step_s) * 1e9) for i in range(n_ticks)]
    return [Tick(time.x(moment), clock(moment).removesuffix(".0")) for moment in moments]
