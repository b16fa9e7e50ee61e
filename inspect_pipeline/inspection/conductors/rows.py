"""Rows of the table conductors: what a flight measured of each conductor of a span."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from inspect_pipeline.arrays import Floats
    from inspect_pipeline.inspection.conductors.fit import ConductorFit
    from inspect_pipeline.inspection.conductors.layout import Place
    from inspect_pipeline.inspection.span_evidence import SpanEvidence

_SWING_SD = np.tan(np.radians(12.0))  # of the sag: how far aside wind may swing conductors
_COMMON_SD_M = 0.5  # of the height of all conductors together, which the spans file gives


@dataclass(frozen=True, slots=True)
class ConductorRow:
    """A row of the table conductors, None for what was not measured. schemas/ documents the columns."""

    channel_id: int
    span_id: str
    conductor: int
    n_frames: int
    judged_m: float
    present_m: float
    across_m: float
    across_sd_m: float | None
    raised_m: float
    raised_sd_m: float | None
    sag_m: float | None
    sag_sd_m: float | None
    ground_m: float | None
    ground_sd_m: float | None
    clearance_m: float | None
    nearest: int | None


def conductor_rows(
    channel_id: int, one: SpanEvidence, fits: Sequence[ConductorFit | None]
) -> Iterator[ConductorRow]:
    """Yield the rows of all conductors of a span where any was judged; fits (K,) are theirs.

    One that was judged nowhere has a row too: that it is unknown there is not that it is missing.
    """
    if one.votes is None or not one.is_judged.any():
        return
    is_present, is_judged = one.is_present, one.is_judged
    lines = [_points(one, fit.place) if fit else None for fit in fits]
    for k, (common, fit) in enumerate(zip(one.places, fits, strict=True)):
        place = fit.place if fit else common
        sd = fit.sd if fit else (None, None, None)
        raised_sd_m = float(np.hypot(sd[1], _COMMON_SD_M)) if sd[1] is not None else None
        sag_m = _nominal_sag_m(one) + place.sag_m if fit else None
        sag_sd_m = _sag_sd_m(one, fit) if fit else None
        nearest, clearance_m = _nearest(lines, k)
        points = lines[k]
        yield ConductorRow(
            channel_id=channel_id,
            span_id=one.axis.span_id,
            conductor=k + 1,
            n_frames=int(one.votes.in_frame[:, k].sum()),
            judged_m=round(float(is_judged[k].sum() * one.axis.bin_m), 3),
            present_m=round(float(is_present[k].sum() * one.axis.bin_m), 3),
            across_m=place.across_m,
            across_sd_m=sd[0],
            raised_m=place.raised_m,
            raised_sd_m=raised_sd_m,
            sag_m=sag_m,
            sag_sd_m=sag_sd_m,
            ground_m=float((points[:, 1] - one.axis.ground_m).min()) if points is not None else None,
            ground_sd_m=float(np.hypot(raised_sd_m, sag_sd_m)) if raised_sd_m and sag_sd_m else None,
            clearance_m=clearance_m,
            nearest=nearest,
        )


def _nominal_sag_m(one: SpanEvidence) -> float:
    return float((one.axis.chord_m - one.axis.centres[:, 2]).max())


def _sag_sd_m(one: SpanEvidence, fit: ConductorFit) -> float:
    """Return the standard deviation of a sag, with that of the swing, which may itself look like less sag."""
    nominal_m = _nominal_sag_m(one)
    swing_m = _SWING_SD * max(nominal_m, nominal_m + fit.place.sag_m)
    return float(np.hypot(fit.sd[2], fit.by_swing * swing_m))


def _points(one: SpanEvidence, place: Place) -> Floats:
    """Return positions across and heights (B, 2) of a conductor."""
    heights = one.axis.centres[:, 2] + place.raised_m - place.sag_m * one.sight.parabola
    return np.column_stack((np.full(len(heights), place.across_m), heights))


def _nearest(lines: Sequence[Floats | None], k: int) -> tuple[int | None, float | None]:
    """Return the number of the conductor nearest to one, counted from 1, and their least distance."""
    own = lines[k]
    distances = {
        j + 1: float(np.hypot(*(own - other).T).min())
        for j, other in enumerate(lines)
        if own is not None and other is not None and j != k
    }
    if not distances:
        return None, None
    nearest = min(distances, key=lambda number: distances[number])
    return nearest, distances[nearest]
