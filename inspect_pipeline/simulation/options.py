"""Options of a simulated flight."""

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
    """What is written: a recording by Foxglove's schemas in protobuf or those of ROS 2, or photographs."""

    FOXGLOVE = "foxglove"
    ROS2 = "ros2"
    PHOTOGRAPHS = "photographs"


class RenderKind(StrEnum):
    """How conductors are rendered: drawn, or ray-traced by Mitsuba (extra `synth`)."""

    DRAWN = "drawn"
    PBR = "pbr"


class WeatherKind(StrEnum):
    """Light of a flight: a clear morning, haze, or a low sun with long shadows."""

    CLEAR = "clear"
    HAZE = "haze"
    LOW_SUN = "low-sun"


class TowerKind(StrEnum):
    """What carries the conductors: wooden poles, or lattice towers of steel."""

    WOOD = "wood"
    STEEL = "steel"


class FaultKind(StrEnum):
    """Faults to plant: of the line first, then of frames and messages."""

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
    """Options of a simulated flight.

    Attributes:
        seconds: length of the flight.
        fps: images per second.
        image_size: (height, width).
        seed: decides the landscape, the direction of the line and the sway of the drone.
        flight: how the drone flies.
        n_structures: of a line that ends; the first stands behind the start. None for a line longer than the
            flight.
        n_phases: conductors beside each other; a neutral hangs below them.
        n_bundle: wires of each phase.
        n_circuits: with 2, the phases of each hang below each other on either side.
        position_noise_m: standard deviation of each recorded position, on each axis.
        drift_m: amplitude of a slow error of positions, on each axis.
        attitude_noise_deg: standard deviation of each recorded angle of the camera.
        corner_deg: by how much the line turns left, at a structure in the middle of the flight.
        hills_m: height of the hills that the line and the drone go over.
        wind_deg: by how much wind swings the conductors out; the drone sways more, too.
        weather: of the pictures.
        towers: that are drawn.
        faults: planted once for each time they are named.
        schema: of the messages; or photographs for `pack` instead of a recording.
        ground: a photograph from above to use as the ground; None draws it.
        render: how conductors are rendered.
    """

    seconds: float = 20.0
    fps: float = 2.0
    image_size: tuple[int, int] = (720, 1280)
    seed: int = 0
    flight: FlightKind = FlightKind.PASS_BY
    n_structures: int | None = None
    n_phases: int = 3
    n_bundle: int = 1
    n_circuits: int = 1
    position_noise_m: float = 0.0
    drift_m: float = 0.0
    attitude_noise_deg: float = 0.0
    corner_deg: float = 0.0
    hills_m: float = 0.0
    wind_deg: float = 0.0
    weather: WeatherKind = WeatherKind.CLEAR
    towers: TowerKind = TowerKind.WOOD
    faults: tuple[FaultKind, ...] = ()
    schema: SchemaKind = SchemaKind.FOXGLOVE
    ground: Path | None = None
    render: RenderKind = RenderKind.DRAWN
