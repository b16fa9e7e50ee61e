"""How much was seen, in four definitions that are never mixed.

frame      usable frames of those that the camera's median period lets expect
detection  time, and path, with at least one line that was followed over frames
span       metres of a span's axis with a line along it in a frame that shows them finely enough
corridor   the same of the ground below the path that was flown, with any followed line in the frame
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
from inspect_pipeline.inspection.coverage.rows import Bins, Coverage, Gap
from inspect_pipeline.inspection.rows import find_origin, runs_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from inspect_pipeline.inspection.rows import CameraRows
    from inspect_pipeline.inspection.rules import Rules
    from inspect_pipeline.inspection.spans import Span


@dataclass(frozen=True, slots=True)
class FlightCoverage:
    """All that a flight covered."""

    numbers: tuple[Coverage, ...]
    gaps: tuple[Gap, ...]
    bins: tuple[Bins, ...]


def measure_coverage(cameras: Sequence[CameraRows], spans: Sequence[Span], rules: Rules) -> FlightCoverage:
    """The coverage of a flight by all its cameras."""
    numbers: list[Coverage] = []
    gaps: list[Gap] = []
    for camera in cameras:
        numbers += [measure_frames(camera, rules), *measure_detection(camera, rules)]
        gaps += [*find_dropouts(camera, rules), *find_detection_gaps(camera, rules)]
    numbers += _over_cameras(numbers)
    origin = find_origin(cameras)
    if origin is None:
        return FlightCoverage(tuple(numbers), tuple(gaps), ())
    bins = [*span_bins(cameras, spans, origin, rules), *corridor_bins(cameras, origin, rules)]
    numbers += [_count_bins(one, rules) for one in bins]
    return FlightCoverage(tuple(numbers), tuple(gaps), tuple(bins))


def _over_cameras(numbers: Sequence[Coverage]) -> list[Coverage]:
    """The sums over the cameras of a flight, by kind and unit; the longest gap is that of any camera."""
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
                total=sum(one.total for one in same),
                imaged=None,
                covered=sum(one.covered for one in same),
                longest_gap_s=max(gaps_s, default=None),
                longest_gap_m=max(gaps_m, default=None),
                thresholds=same[0].thresholds,
            )
        )
    return sums


def _count_bins(bins: Bins, rules: Rules) -> Coverage:
    is_covered = bins.n_detected > 0
    longest = max((len(run) for run in runs_of(~is_covered, 1)), default=0)
    names = ("bin_m", "max_gsd_m", "corridor_half_m", "max_angle_deg", "max_pose_age_ms")
    return Coverage(
        bins.kind,
        None,
        bins.span_id,
        "m",
        total=len(is_covered) * bins.bin_m,
        imaged=float((bins.n_frames > 0).sum() * bins.bin_m),
        covered=float(is_covered.sum() * bins.bin_m),
        longest_gap_s=None,
        longest_gap_m=float(longest * bins.bin_m),
        thresholds={name: rules.coverage[name] for name in names},
    )
