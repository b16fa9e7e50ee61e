"""The ground along a flight, where it was placed over a terrain model: heights above one datum.

Frames know how far the ground rises below them, and where their optical axis meets it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from inspect_pipeline.arrays import Floats
    from inspect_pipeline.geometry.local_frame import LocalMetres
    from inspect_pipeline.inspection.rows import CameraRows, FrameRows

_MAX_RANGE_M, _MAX_SAMPLES = 100.0, 1500
_BLUR_M = 6.0  # at least; as much as the nearest sample is away
_LEVEL_M = 1.0  # extent of samples from which on their slope counts: others say nothing of it
_SLOPE_M = 25.0  # how far a slope goes on beyond the samples
_LITTLE_M = 1.0  # by which the ground varies, where it is taken as known farther away
_AT_A_TIME = 256


@dataclass(frozen=True, slots=True, eq=False)
class Ground:
    """Places (S, 2) in local metres with heights (S,) of the ground in m above that of the first position.

    Without any, the ground is level.
    """

    places: Floats
    heights_m: Floats

    def at(self, places: Floats) -> Floats:
        """Return heights (P,) at places (P, 2), by planes fitted to the samples around each."""
        found = np.zeros(len(places))
        if not len(self.heights_m):
            return found
        for start in range(0, len(places), _AT_A_TIME):
            some = slice(start, start + _AT_A_TIME)
            found[some] = self._fit(np.asarray(places[some]))
        return found

    def is_known(self, places: Floats) -> bool:
        """Return whether samples are near all places (P, 2), or the ground varies little."""
        if not len(self.heights_m) or np.ptp(self.heights_m) <= _LITTLE_M:
            return True
        away_m = np.linalg.norm(self.places - places[:, np.newaxis], axis=2)
        return bool((away_m.min(axis=1) <= _SLOPE_M).all())

    def _fit(self, places: Floats) -> Floats:
        nearest = self.places[((self.places - places[:, np.newaxis]) ** 2).sum(axis=2).argmin(axis=1)]
        beyond = places - nearest
        far_m = np.maximum(np.linalg.norm(beyond, axis=1, keepdims=True), _SLOPE_M)
        away = self.places[np.newaxis] - (nearest + beyond * (_SLOPE_M / far_m))[:, np.newaxis]
        squared = (away**2).sum(axis=2)
        least = squared.min(axis=1, keepdims=True)
        # The nearest sample has a weight of 1, however far away it is.
        weights = np.exp((least - squared) / (2 * np.maximum(least, _BLUR_M**2)))
        terms = np.concatenate((np.ones((*squared.shape, 1)), away), axis=2)
        normal = np.einsum("ps,psi,psj->pij", weights, terms, terms)
        normal += weights.sum(axis=1)[:, np.newaxis, np.newaxis] * np.diag((0.0, _LEVEL_M**2, _LEVEL_M**2))
        right = np.einsum("ps,psi,s->pi", weights, terms, self.heights_m)
        return np.asarray(np.linalg.solve(normal, right[..., np.newaxis])[:, 0, 0])


LEVEL = Ground(np.zeros((0, 2)), np.zeros(0))


def find_ground(cameras: Sequence[CameraRows], origin: LocalMetres) -> Ground:
    """Return what the frames of a flight know of the ground."""
    samples = np.concatenate([_samples(one.frames, origin) for one in cameras] or [np.zeros((0, 3))])
    samples = samples[:: max(1, -(-len(samples) // _MAX_SAMPLES))]
    return Ground(samples[:, :2], samples[:, 2])


def _samples(frames: FrameRows, origin: LocalMetres) -> Floats:
    """Return samples (S, 3) of the ground below frames, and where their optical axes meet it."""
    here = origin.to_metres(frames.lat_deg, frames.lon_deg)
    there = origin.to_metres(frames.ground_lat_deg, frames.ground_lon_deg)
    range_m = frames.gsd_m * frames.focal_px
    with np.errstate(invalid="ignore"):
        down_m = np.sqrt(range_m**2 - ((there - here) ** 2).sum(axis=1))
        down_m[range_m > _MAX_RANGE_M] = np.nan
    met_m = frames.rise_m + frames.height_m - down_m
    samples = np.concatenate((np.column_stack((here, frames.rise_m)), np.column_stack((there, met_m))))
    return np.asarray(samples[np.isfinite(samples).all(axis=1)])
