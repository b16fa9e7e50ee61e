"""The rows of the tables coverage, coverage_gaps and coverage_bins."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from inspect_pipeline.arrays import Floats, Ints


@dataclass(frozen=True, slots=True)
class Coverage:
    """A row of the table coverage."""

    kind: Literal["frame", "detection", "span", "corridor"]
    channel_id: int | None
    span_id: str | None
    unit: Literal["frames", "s", "m"]
    total: float
    imaged: float | None
    covered: float
    longest_gap_s: float | None
    longest_gap_m: float | None
    thresholds: dict[str, float]

    @property
    def share(self) -> float | None:
        """Covered of total, 0 to 1."""
        return self.covered / self.total if self.total > 0 else None


@dataclass(frozen=True, slots=True)
class Gap:
    """A row of the table coverage_gaps."""

    kind: Literal["frame", "detection"]
    channel_id: int
    first_frame_idx: int
    last_frame_idx: int
    n_frames: int
    start_ns: int
    end_ns: int
    length_m: float | None

    @property
    def duration_s(self) -> float:
        """From start to end."""
        return (self.end_ns - self.start_ns) / 1e9


@dataclass(frozen=True, slots=True, eq=False)
class Bins:
    """Rows of the table coverage_bins, those of one span or of the corridor: arrays (B,)."""

    kind: Literal["span", "corridor"]
    span_id: str | None
    bin_m: float
    lat_deg: Floats
    lon_deg: Floats
    n_frames: Ints
    n_detected: Ints
    best_gsd_m: Floats
    first_ns: Ints
    last_ns: Ints
