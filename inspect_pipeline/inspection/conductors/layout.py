"""Find where conductors hang: places across and heights at which lines of many frames agree."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import gaussian_filter1d

if TYPE_CHECKING:
    from collections.abc import Sequence

    from inspect_pipeline.arrays import Ints
    from inspect_pipeline.inspection.conductors.sight import SpanSight

_CELL_M, _REACH_M = 0.05, 12.0
_HEIGHTS_M = np.arange(-4.0, 4.01, 0.5)
_HEIGHT_PENALTY = 0.01  # per square metre: of equal places, that nearest to the nominal height
_BLUR_M, _NEAR_M = 0.12, 0.3  # of places; around one, in which lines belong to it
_SEPARATE_M, _MIN_TOGETHER = 0.75, 0.3  # nearer places are two only where frames show both at once
_MIN_BINS, _MIN_SHARE = 6, 0.35  # metres, along which a share of the frames has a conductor
_MIN_VIEWS = 2
_MAX_CONDUCTORS = 24
_NOISE_PX = 3.0


@dataclass(frozen=True, slots=True)
class Place:
    """Where a conductor hangs: across, and above the nominal height, in metres; more sag than nominal."""

    across_m: float
    raised_m: float
    sag_m: float = 0.0


def find_places(sights: Sequence[SpanSight]) -> list[Place]:
    """Return the places of conductors that spans with the same structures have in common."""
    pool = _Pool(sights)
    places: list[Place] = []
    while len(places) < _MAX_CONDUCTORS and pool.is_open.any():
        place = pool.best()
        own = pool.take(place)
        if not pool.is_steady(own):
            if not pool.retry():
                break
            continue
        if all(pool.is_other(own, other) for other in places):
            places.append(place)
    return sorted(places, key=lambda place: place.across_m)


class _Pool:
    """Crossings of several spans, of which those of found places are taken out."""

    def __init__(self, sights: Sequence[SpanSight]) -> None:
        self.sights = sights
        sizes = [len(one.view.across_m) for one in sights]
        self.owner = np.repeat(np.arange(len(sights)), sizes)
        self.is_open = np.concatenate([one.fine[one.view.frame, one.view.bin] for one in sights])
        self.lifted = [np.concatenate([one.at_height(e, 0.0) for one in sights]) for e in _HEIGHTS_M]
        scale = np.concatenate([one.scale_px[one.view.frame, one.view.bin] for one in sights])
        self.near_m = np.clip(_NOISE_PX / np.maximum(scale, 1e-9), 0.12, _NEAR_M)
        self.bins = np.concatenate([one.view.bin for one in sights])
        frames = np.cumsum([0, *(len(one.rows) for one in sights)])
        self.frames = np.concatenate([one.view.frame + frames[i] for i, one in enumerate(sights)])
        self.n_bins = max(len(one.axis.centres) for one in sights)
        self.views = np.zeros((len(sights), self.n_bins))
        for i, one in enumerate(sights):
            self.views[i, : len(one.axis.centres)] = one.fine.sum(axis=0)
        self.n_failures = 0

    def best(self) -> Place:
        """Return the place that explains most of what is left."""
        n_cells = round(2 * _REACH_M / _CELL_M)
        best, found = -np.inf, Place(0.0, 0.0)
        for i, raised_m in enumerate(_HEIGHTS_M.tolist()):
            cells = np.round((self.lifted[i][self.is_open] + _REACH_M) / _CELL_M).astype(np.int64)
            cells = cells[(cells >= 0) & (cells < n_cells)]
            votes = gaussian_filter1d(
                np.bincount(cells, minlength=n_cells).astype(np.float64), _BLUR_M / _CELL_M
            )
            score = votes.max() * (1 - _HEIGHT_PENALTY * raised_m**2)
            if score > best:
                best, found = score, Place(float(votes.argmax() * _CELL_M - _REACH_M), raised_m)
        self.height = int(np.flatnonzero(found.raised_m == _HEIGHTS_M)[0])
        return found

    def take(self, place: Place) -> Ints:
        """Return the open crossings near a place, and take them out."""
        away = np.abs(self.lifted[self.height] - place.across_m)
        own = np.flatnonzero(self.is_open & (away <= np.maximum(self.near_m, 0.2)))
        self.is_open[own] = False
        return own

    def is_steady(self, own: Ints) -> bool:
        """Return whether enough frames have a conductor there along some metres of half of the spans."""
        key = (self.owner[own] * self.n_bins + self.bins[own]) * (self.frames.max() + 1) + self.frames[own]
        bins = np.unique(key) // (self.frames.max() + 1)
        seen = np.bincount(bins, minlength=self.views.size).reshape(self.views.shape)
        steady = (seen >= _MIN_SHARE * self.views) & (seen >= _MIN_VIEWS)
        n_steady = int(np.count_nonzero(steady.sum(axis=1) >= _MIN_BINS))
        n_seen = int(np.count_nonzero((self.views >= _MIN_VIEWS).sum(axis=1) >= _MIN_BINS))
        return bool(n_steady >= max(1, n_seen // 2))

    def retry(self) -> bool:
        """Return whether to look for further places after one that was not steady."""
        self.n_failures += 1
        return self.n_failures < 3

    def is_other(self, own: Ints, other: Place) -> bool:
        """Return whether crossings are of another conductor than a known one: frames show both at once."""
        i = int(np.flatnonzero(other.raised_m == _HEIGHTS_M)[0])
        away = np.abs(self.lifted[i] - other.across_m)
        nearest = np.median(np.abs(self.lifted[i][own] - other.across_m)) if len(own) else 0.0
        if nearest > _SEPARATE_M:
            return True
        width = int(self.n_bins)
        near_other = np.setdiff1d(np.flatnonzero(away <= np.maximum(self.near_m, 0.2)), own)
        mine = np.unique(self.frames[own] * width + self.bins[own])
        theirs = np.unique(self.frames[near_other] * width + self.bins[near_other])
        return len(np.intersect1d(mine, theirs)) >= _MIN_TOGETHER * len(mine)
