"""Measure coverage in four definitions, which are never mixed.

frame      usable frames of those that the frame rate predicts
detection  time, and path, with at least one confirmed line
span       metres of the axis of a span with a line along it in a frame that shows them finely enough
corridor   the same for the ground below the path, with any confirmed line in the frame
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from inspect_pipeline.inspection.coverage.bins import corridor_bins, span_bins
from inspect_pipeline.inspection.coverage.frames import (
    find_detection_gaps,
    find_dropouts,
    measure_detection,
    measure_frames,
)
from inspect_pipeline.inspection.coverage.rows import Bins, Coverage, CoverageKind, Gap
from inspect_pipeline.inspection.poses import find_origin
from inspect_pipeline.inspection.rows import find_runs

if TYPE_CHECKING:
    from collections.abc import Sequence

    from inspect_pipeline.inspection.rows import CameraRows
    from inspect_pipeline.inspection.rules import Rules
    from inspect_pipeline.inspection.spans import Span

_THRESHOLDS = ("bin_m", "max_gsd_m", "corridor_half_m", "max_angle_deg", "max_pose_age_ms", "near_m")


@dataclass(frozen=True, slots=True)
class FlightCoverage:
    """Coverage of a flight: rows of three tables."""

    numbers: tuple[Coverage, ...]
    gaps: tuple[Gap, ...]
    bins: tuple[Bins, ...]


def measure_coverage(cameras: Sequence[CameraRows], spans: Sequence[Span], rules: Rules) -> FlightCoverage:
    """Measure the coverage of a flight by all its cameras."""
    numbers: list[Coverage] = []
    gaps: list[Gap] = []
    for camera in cameras:
        numbers += [measure_frames(camera, rules), *measure_detection(camera, rules)]
        gaps += [*find_dropouts(camera, rules), *find_detection_gaps(camera, rules)]
    numbers += _over_cameras(numbers)
    origin = find_origin(cameras)
    if origin is None:
        kinds: tuple[CoverageKind, ...] = ("span", "corridor") if cameras else ()
        numbers += [_unknown_coverage(kind, rules) for kind in kinds]
        return FlightCoverage(tuple(numbers), tuple(gaps), ())
    bins = [*span_bins(cameras, spans, origin, rules), *corridor_bins(cameras, origin, rules)]
    numbers += [_count_bins(one, rules) for one in bins]
    return FlightCoverage(tuple(numbers), tuple(gaps), tuple(bins))


def _over_cameras(numbers: Sequence[Coverage]) -> list[Coverage]:
    """Sum over the cameras of a flight by kind and unit. The longest gap is that of any camera."""
    sums = []
    for kind, unit in dict.fromkeys((one.kind, one.unit) for one in numbers):
        same = [one for one in numbers if (one.kind, one.unit) == (kind, unit)]
        gaps_s = [one.longest_gap_s for one in same if one.longest_gap_s is not None]
        gaps_m = [one.longest_gap_m for one in same if one.longest_gap_m is not None]
        sums.append(
            Coverage(
                kind,
                None,
                None,
                unit,
                total=sum(one.total or 0.0 for one in same),
                imaged=None,
                covered=sum(one.covered or 0.0 for one in same),
                longest_gap_s=max(gaps_s, default=None),
                longest_gap_m=max(gaps_m, default=None),
                thresholds=same[0].thresholds,
            )
        )
    return sums


def _unknown_coverage(kind: CoverageKind, rules: Rules) -> Coverage:
    """Return the row of a flight without positions."""
    return Coverage(
        kind,
        None,
        None,
        "m",
        total=None,
        imaged=None,
        covered=None,
        longest_gap_s=None,
        longest_gap_m=None,
        thresholds=_thresholds(rules),
        reason="position unknown",
    )


def _thresholds(rules: Rules) -> dict[str, float]:
    return {name: rules.coverage[name] for name in _THRESHOLDS}


def _count_bins(bins: Bins, rules: Rules) -> Coverage:
    """Sum the bins of a span or of the corridor."""
    is_covered = bins.n_detected > 0
    is_known = not bins.is_unknown.all()
    longest = max((len(run) for run in find_runs(~is_covered & ~bins.is_unknown, 1)), default=0)
    return Coverage(
        bins.kind,
        None,
        bins.span_id,
        "m",
        total=len(is_covered) * bins.bin_m,
        imaged=float((bins.n_frames > 0).sum() * bins.bin_m) if is_known else None,
        covered=float(is_covered.sum() * bins.bin_m) if is_known else None,
        longest_gap_s=None,
        longest_gap_m=float(longest * bins.bin_m) if is_known else None,
        thresholds=_thresholds(rules),
        unknown=float(bins.is_unknown.sum() * bins.bin_m),
        reason=bins.reason,
        passed=bins.passed_m,
    )
