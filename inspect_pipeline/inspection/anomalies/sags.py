"""Rule about conductors that hang lower or higher than the others of their span."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from inspect_pipeline.inspection.anomalies.frames import Finding

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from inspect_pipeline.geometry.local_frame import LocalMetres
    from inspect_pipeline.inspection.anomalies.conductors import SpanConductor
    from inspect_pipeline.inspection.conductors.fit import ConductorFit
    from inspect_pipeline.inspection.conductors.layout import Place
    from inspect_pipeline.inspection.rules import Rules
    from inspect_pipeline.inspection.span_evidence import SpanEvidence


_MIN_HANGING = 0.5  # of the sag: where a conductor evidently hangs lower than others
_MEDIAN_TO_SD = 1.4826
_MIN_SIGNIFICANCE = 3.0  # standard deviations of a difference of sag
_MAX_LIMIT_M = 1.4  # of a difference of sag that is looked for
_NOISY_SAGS = 6  # errors of poses, which take up part of a sag, make it three times less certain
_MIN_SAGS = 3  # conductors whose sag is compared


def measured_fits(
    one: SpanEvidence, conductors: Sequence[SpanConductor], rules: Rules
) -> list[tuple[int, int, ConductorFit]]:
    """Return numbers, tracks and fits of the conductors whose sag is known well enough to be compared.

    None where sags differ so much that an outlier would not stand out.
    """
    most_m = rules.of("sag_change")["min_difference_m"] / (2 if one.sight.is_exact else _NOISY_SAGS)
    fits = [(one.number, one.track, one.fit) for one in conductors if one.fit and one.fit.sd[2] <= most_m]
    is_known = len(fits) >= _MIN_SAGS and _MIN_SIGNIFICANCE * _spread_m(fits) <= _MAX_LIMIT_M
    return fits if is_known else []


def _spread_m(fits: Sequence[tuple[int, int, ConductorFit]]) -> float:
    """Return the standard deviation of most sags."""
    sags_m = np.array([fit.place.sag_m for *_, fit in fits])
    return float(np.median(np.abs(sags_m - np.median(sags_m)))) * _MEDIAN_TO_SD


def find_sag_changes(
    one: SpanEvidence, conductors: Sequence[SpanConductor], origin: LocalMetres, rules: Rules
) -> Iterator[Finding]:
    """Find the conductor whose sag differs most from the median of the span."""
    limits = rules.of("sag_change")
    measured = measured_fits(one, conductors, rules)
    if not measured:
        return
    usual_m = float(np.median([fit.place.sag_m for *_, fit in measured]))
    fitted = measured
    if one.sight.is_exact:  # the sag of one that hangs much lower need not be known as well
        fitted = [(each.number, each.track, each.fit) for each in conductors if each.fit]
    number, track, outlier = max(
        fitted, key=lambda each: abs(each[-1].place.sag_m - usual_m) - each[-1].sd[2]
    )
    difference_m = outlier.place.sag_m - usual_m
    sd_m = max(outlier.sd[2], _spread_m(measured))
    limit_m = max(limits["min_difference_m"], _MIN_SIGNIFICANCE * sd_m)
    if abs(difference_m) < limit_m or outlier.misfit_m > limits["max_misfit_m"]:
        return
    others = [fit.place for each, _, fit in measured if each != number]
    if not one.sight.is_exact and abs(outlier.place.sag_m - _trend_m(others, outlier.place)) < limit_m:
        return
    word = "lower" if difference_m > 0 else "higher"
    bins = np.flatnonzero(one.sight.parabola > _MIN_HANGING)
    if len(bins):
        yield Finding(
            "sag_change",
            one.rows_showing(bins, [outlier.place]),
            f"a conductor hangs {abs(difference_m):.1f} m {word} than the others of span {one.axis.span_id}",
            abs(difference_m),
            limit_m,
            "m",
            track_id=track,
            span_id=one.axis.span_id,
            place=one.place(bins, origin),
            conductors=(number,),
        )


def _trend_m(others: Sequence[Place], at: Place) -> float:
    """Return the sag of other conductors, extrapolated across: errors of poses tilt those of all."""
    across_m = np.array([each.across_m for each in others]) - at.across_m
    sags_m = np.array([each.sag_m for each in others])
    away_m = across_m - across_m.mean()
    slope = (away_m @ sags_m) / max(float(away_m @ away_m), 1e-9)
    return float(sags_m.mean() - slope * across_m.mean())
