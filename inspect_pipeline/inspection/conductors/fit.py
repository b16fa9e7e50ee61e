"""Fit each conductor of a span by itself: where it hangs, its sag, and how well that is known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from inspect_pipeline.inspection.conductors.layout import Place
from inspect_pipeline.inspection.conductors.refine import predict_across

if TYPE_CHECKING:
    from inspect_pipeline.arrays import Floats, Ints
    from inspect_pipeline.inspection.conductors.sight import SpanSight

_PRIOR_SD = np.array([0.3, 0.3, 3.0])  # about the place that all spans have in common; sag is free
_NOISE_M = 0.1  # at least, of the lines of a conductor in a frame
_ITERATIONS = 8
_MAX_AWAY = 4.0  # times the median residual: others are outliers
_MISFIT_QUANTILE = 0.8
_MIN_FITTING = 0.85  # of the crossings; else they are those of two conductors


@dataclass(frozen=True, slots=True)
class ConductorFit:
    """A conductor of a span: its place with standard deviations, and the misfit of its lines, in metres.

    sd: of across_m, raised_m and sag_m. misfit_m: distance from the parabola, of most crossings. by_swing: by
    how much sag_m is wrong for each metre that wind swings the middle aside; little if seen from both sides.
    """

    place: Place
    sd: tuple[float, float, float]
    misfit_m: float
    by_swing: float


def fit_conductor(sight: SpanSight, crossings: Ints, place: Place) -> ConductorFit | None:
    """Return the fit of a conductor to crossings (rows of the view), None where they are of several."""
    start = np.array([place.across_m, place.raised_m, place.sag_m])
    values, frames = start.copy(), sight.view.frame[crossings]
    fits = np.ones(len(crossings), bool)
    inverse, away = np.diag(_PRIOR_SD**2), np.zeros(len(crossings))
    parabola, by_swing = sight.parabola[sight.view.bin[crossings]], 0.0
    for _ in range(_ITERATIONS):
        appears, terms = predict_across(sight, crossings, Place(*values.tolist()))
        residuals = sight.view.across_m[crossings] - appears
        weights = _frame_weights(frames, fits, residuals)
        normal = (terms * weights[:, np.newaxis]).T @ terms + np.diag(_PRIOR_SD**-2)
        inverse = np.linalg.inv(normal)
        right = (terms * weights[:, np.newaxis]).T @ residuals - np.diag(_PRIOR_SD**-2) @ (values - start)
        by_swing = float((inverse @ ((terms * weights[:, np.newaxis]).T @ (terms[:, 0] * parabola)))[2])
        values = values + inverse @ right
        away = np.abs(residuals - terms @ (inverse @ right))
        fits = away <= _MAX_AWAY * max(float(np.median(away)), 0.01)
    if fits.mean() < _MIN_FITTING:
        return None
    sd = np.sqrt(np.diag(inverse))
    misfit_m = float(np.quantile(away, _MISFIT_QUANTILE))
    known = float(sd[0]), float(sd[1]), float(sd[2])
    return ConductorFit(Place(*values.tolist()), known, misfit_m, by_swing)


def _frame_weights(frames: Ints, fits: np.ndarray, residuals: Floats) -> Floats:
    """Return weights (C,) by which each frame counts once: the crossings of a frame share its errors."""
    counts = np.bincount(frames, fits.astype(float))
    noise_m = max(_NOISE_M, float(np.median(np.abs(residuals[fits]))) if fits.any() else 0.0)
    return np.asarray(fits / np.maximum(counts[frames], 1.0) / noise_m**2)
