"""Numbers, times and names in words, as the pages show them."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from typing import Any

from markupsafe import Markup

from inspect_pipeline.errors import printable

NONE = "–"

KINDS = {
    "conductor_count": "Conductor count",
    "conductor_lost": "Conductor lost",
    "conductor_gap": "Gap in a conductor",
    "conductors_converging": "Conductors too close",
    "sag_change": "Change of sag",
    "crossing_line": "Crossing line",
    "orientation_jump": "Camera turned",
    "blurred_frames": "Blurred frames",
    "dark_frames": "Dark frames",
    "overexposed_frames": "Overexposed frames",
    "sensor_dropout": "Frames missing",
    "clock_step": "Clock step",
    "stale_pose": "Old pose",
}
# What each kind of coverage counts: its title, and its definition in a sentence.
COVERAGE = {
    "frame": (
        "Usable frames",
        "of the frames that the frame rate predicts: decoded, and neither blurred, dark nor overexposed",
    ),
    "detection": (
        "Time with lines",
        "of the time from the first to the last frame, in which lines were followed",
    ),
    "span": (
        "Spans seen",
        "of the length of the spans flown by: shown finely enough, with a line along the span",
    ),
    "corridor": (
        "Ground seen",
        "of the ground below the path: shown finely enough, with a line in the frame",
    ),
}


def clean(value: Any) -> Any:
    """Return what a template prints: a dash for None, text without control characters."""
    if value is None:
        return NONE
    if isinstance(value, str) and not isinstance(value, Markup):
        return printable(value)
    return value


def kind_name(kind: str) -> str:
    """Return the name of a kind of anomaly."""
    return KINDS.get(kind, kind.replace("_", " ").capitalize())


def percent(share: float | None) -> str:
    """Return a share as a percentage; below 100 % never rounded up to it."""
    if share is None:
        return NONE
    value = 100 * share
    return f"{min(value, 99.9) if value < 100 else value:.1f} %".replace(".0 %", " %")


def metres(value: float | None) -> str:
    """Return a length: metres, or kilometres from 2,000 m on."""
    if value is None:
        return NONE
    if value >= 2000:
        return f"{value / 1000:.1f} km"
    return f"{value:.1f} m" if value < 10 else f"{value:.0f} m"


def duration(seconds: float | None) -> str:
    """Return a duration: seconds, or minutes, or hours."""
    if seconds is None:
        return NONE
    if seconds < 120:
        return f"{seconds:.1f} s".replace(".0 s", " s")
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest:02d} s" if minutes < 120 else f"{minutes // 60} h {minutes % 60:02d} min"


def measured_m(value: float | None, sd: float | None) -> str:
    """Return a length in metres with its standard deviation."""
    if value is None:
        return NONE
    return f"{value:.1f} m" if sd is None else f"{value:.1f} ± {max(sd, 0.1):.1f} m"


def clock(time_ns: int | None) -> str:
    """Return the UTC time of day of nanoseconds since 1970, to a tenth of a second."""
    if time_ns is None:
        return NONE
    time = _moment(time_ns)
    return f"{time:%H:%M:%S}.{time.microsecond // 100_000}"


def date(time_ns: int | None) -> str:
    """Return the UTC date of nanoseconds since 1970."""
    return NONE if time_ns is None else f"{_moment(time_ns):%Y-%m-%d}"


def quantity(value: float, unit: str) -> str:
    """Return a value with its unit, with three digits."""
    number = f"{value:,.0f}" if abs(value) >= 100 or value == int(value) else f"{value:.3g}"
    return f"{number} {unit}".rstrip()


def nice_step(length: float, n_steps: int) -> float:
    """Return 1, 2 or 5 times a power of ten, so that about `n_steps` of them make the length."""
    rough = max(length, 1e-9) / n_steps
    power = 10.0 ** math.floor(math.log10(rough))
    return next(factor * power for factor in (1, 2, 5, 10) if factor * power >= rough)


def _moment(time_ns: int) -> datetime:
    return datetime.fromtimestamp(time_ns // 10**9, UTC).replace(microsecond=time_ns % 10**9 // 1000)
