"""Records of the ground truth of a simulated flight: structures, conductors, faults, and visible lines.

`truth.simulate_truth(options)` computes them without drawing; `write.simulate_flight` draws the same flight.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from collections.abc import Mapping

    from inspect_pipeline.arrays import Floats
    from inspect_pipeline.simulation.options import FaultKind, SimulationOptions

Quality = Literal["ok", "blurred", "dark", "overexposed"]


@dataclass(frozen=True, slots=True)
class StructureTruth:
    """A pole: position (WGS 84), ellipsoidal altitude of its foot, and height."""

    structure_id: str
    lat_deg: float
    lon_deg: float
    alt_m: float
    height_m: float


@dataclass(frozen=True, slots=True)
class SpanTruth:
    """The conductors between two structures; `expected_conductors` counts those that should hang there."""

    span_id: str
    structure_ids: tuple[str, str]
    length_m: float
    expected_conductors: int


@dataclass(frozen=True, slots=True, eq=False)
class LineTruth:
    """The visible part of a conductor, which may run over several spans.

    points: (N, 2) float64 px along it; width_px: (N,). span_id is the span that has most of it, None for a
    conductor of another line; span_ids are all, in order.
    """

    conductor_id: str
    span_id: str | None
    span_ids: tuple[str, ...]
    points: Floats
    width_px: Floats


@dataclass(frozen=True, slots=True)
class SpanViewTruth:
    """What a frame shows of a span's axis (the mean of its conductors): metres from its first structure.

    gsd_m: metres per pixel at the nearest and at the farthest point of it.
    """

    span_id: str
    from_m: float
    to_m: float
    nearest_gsd_m: float
    farthest_gsd_m: float


@dataclass(frozen=True, slots=True, eq=False)
class FrameTruth:
    """A frame, or one that was dropped (`frame_idx` None: the recording does not have it).

    The pose is the last one recorded: its position is old during a gap, and its angles do not contain the
    slip of a camera in its mount. pose_age_ms: of the position, None before the first. alt_m: ellipsoidal.
    height_m: above take-off, the ground below the first position; ground_m: of the ground below, above that.
    heading_deg: of the vehicle. Camera angles: yaw clockwise from north, pitch
    positive upwards, roll positive to the right. image_size: (height, width). lines, views: what the picture
    truly shows.
    """

    frame_idx: int | None
    log_time_ns: int
    stamp_ns: int
    lat_deg: float
    lon_deg: float
    alt_m: float
    height_m: float
    ground_m: float
    heading_deg: float
    cam_yaw_deg: float
    cam_pitch_deg: float
    cam_roll_deg: float
    pose_age_ms: float | None
    image_size: tuple[int, int]
    focal_px: float
    quality: Quality
    sharpness: float
    mean_luma: float
    lines: tuple[LineTruth, ...]
    views: tuple[SpanViewTruth, ...]

    @property
    def dropped(self) -> bool:
        """Whether the frame is missing in the recording."""
        return self.frame_idx is None


@dataclass(frozen=True, slots=True)
class SeenInterval:
    """A run of frames that show some of a span: log times of the first and the last."""

    span_id: str
    start_ns: int
    end_ns: int


@dataclass(frozen=True, slots=True)
class FaultTruth:
    """A planted fault: start_ns and end_ns are the log times of the first and the last frame that show it.

    A fault of the line is shown where at least half as much of it is visible as in the frame that shows most
    (a tenth, for a crossing line), in the longest run of frames where there are several. A dropout, clock
    step or orientation jump lies between the last frame before and the first frame after; a gap of positions
    between their last and next message.
    """

    kind: FaultKind
    start_ns: int
    end_ns: int
    span_id: str | None
    conductor_ids: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class FlightTruth:
    """The ground truth of a flight. span_coverage: share of each span's axis that any good frame shows."""

    options: SimulationOptions
    frames: tuple[FrameTruth, ...]
    structures: tuple[StructureTruth, ...]
    spans: tuple[SpanTruth, ...]
    spans_seen: tuple[SeenInterval, ...]
    span_coverage: Mapping[str, float]
    faults: tuple[FaultTruth, ...]
