"""What a simulated flight is like: how long, which way it is flown, what is wrong with it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path


class FlightKind(StrEnum):
    """How the drone flies: along the line, round a structure, in one place, or off the line and back."""

    PASS_BY = "pass-by"  # noqa: S105 - a kind of flight
    ORBIT = "orbit"
    HOVER = "hover"
    LOSS = "loss"


class SchemaKind(StrEnum):
    """What the messages of the recording are: protobuf as Foxglove has them, or those of ROS 2."""

    FOXGLOVE = "foxglove"
    ROS2 = "ros2"


class RenderKind(StrEnum):
    """How conductors come into the pictures: drawn, or traced by Mitsuba (extra `synth`)."""

    DRAWN = "drawn"
    PBR = "pbr"


class FaultKind(StrEnum):
    """What can be wrong with the line, then with the pictures and the messages."""

    MISSING_CONDUCTOR = "missing_conductor"
    BROKEN_CONDUCTOR = "broken_conductor"
    CONDUCTOR_GAP = "conductor_gap"
    SAG_OUTLIER = "sag_outlier"
    CONDUCTORS_TOO_CLOSE = "conductors_too_close"
    CROSSING_LINE = "crossing_line"
    BLUR = "blur"
    DARK = "dark"
    OVEREXPOSED = "overexposed"
    DROPOUT = "dropout"
    GPS_GAP = "gps_gap"
    CLOCK_STEP = "clock_step"
    ORIENTATION_JUMP = "orientation_jump"


LINE_FAULTS = tuple(FaultKind)[:6]
FRAME_FAULTS = tuple(FaultKind)[6:]


@dataclass(frozen=True, slots=True)
class SimulationOptions:
    """How long, how often, how large (height, width), which landscape, which flight, which faults.

    n_structures: of a line that ends, the first one behind the start; None for one longer than the flight.
    n_phases conductors, n_bundle wires each, hang beside each other, and a neutral one below them.
    faults: each is planted once; what is named twice, twice. ground: a photograph of it, else it is drawn.
    """

    seconds: float = 20.0
    fps: float = 2.0
    image_size: tuple[int, int] = (720, 1280)
    seed: int = 0
    flight: FlightKind = FlightKind.PASS_BY
    n_structures: int | None = None
    n_phases: int = 3
    n_bundle: int = 1
    faults: tuple[FaultKind, ...] = ()
    schema: SchemaKind = SchemaKind.FOXGLOVE
    ground: Path | None = None
    render: RenderKind = RenderKind.DRAWN
