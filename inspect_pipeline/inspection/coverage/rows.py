"""Rows of the tables coverage, coverage_gaps and coverage_bins."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from inspect_pipeline.arrays import Floats, Ints, Mask

CoverageKind = Literal["frame", "detection", "span", "corridor"]


@dataclass(frozen=True, slots=True)
class Coverage:
    """A row of the table coverage.

    covered and imaged are None where nothing of `total` can be known, for `reason`; total is None where not
    even that is. unknown: the part of `total` of which nothing can be known. passed: metres of a span within
    near_m of the path.
    """

    kind: CoverageKind
    channel_id: int | None
    span_id: str | None
    unit: Literal["frames", "s", "m"]
    total: float | None
    imaged: float | None
    covered: float | None
    longest_gap_s: float | None
    longest_gap_m: float | None
    thresholds: dict[str, float]
    unknown: float = 0.0
    reason: str | None = None
    passed: float | None = None

    @property
    def share(self) -> float | None:
        """Covered share of what is known, 0 to 1, None when nothing is."""
        if self.covered is None or self.total is None or self.total <= self.unknown:
            return None
        return min(self.covered / (self.total - self.unknown), 1.0)


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
        """Seconds from start to end."""
        return (self.end_ns - self.start_ns) / 1e9


@dataclass(frozen=True, slots=True, eq=False)
class Bins:
    """Rows of the table coverage_bins for one span, or for the corridor: arrays (B,).

    is_unknown: bins of which no frame could show whether they are covered, for `reason`. passed_m: metres of
    a span within near_m of the path.
    """

    kind: Literal["span", "corridor"]
    bin_m: float
    lat_deg: Floats
    lon_deg: Floats
    n_frames: Ints
    n_detected: Ints
    best_gsd_m: Floats
    first_ns: Ints
    last_ns: Ints
    is_unknown: Mask
    reason: str | None
    span_id: str | None = None
    passed_m: float | None = None
