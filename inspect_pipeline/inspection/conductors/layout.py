"""Find where conductors hang: places across and heights at which lines of many frames agree."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import gaussian_filter1d

if TYPE_CHECKING:
    from collections.abc import Sequence

    from inspect_pipeline.arrays import Floats, Ints
    from inspect_pipeline.inspection.conductors.sight import SpanSight

_CELL_M, _REACH_M = 0.02, 12.0
_STEP_M, _ITERATIONS = 0.5, 3  # of heights; to improve on them
_HEIGHTS_M = np.arange(-4.0, 4.01, _STEP_M)
_NOT_WORSE = 0.9  # of the votes for the best height: of these, that nearest to the nominal one
_SEPARATE_M, _MIN_TOGETHER = 0.75, 0.3  # nearer places are two only where frames show both at once
_MIN_BINS, _MIN_SHARE = 6, 0.35  # metres, along which a share of the frames has a conductor
_MIN_VIEWS = 2
_MAX_CONDUCTORS, _MAX_FAILURES = 24, 3


@dataclass(frozen=True, slots=True)
class Place:
    """Where a conductor hangs: across, and above the nominal height, in metres; more sag than nominal."""

    across_m: float
    raised_m: float
    sag_m: float = 0.0


def find_places(sights: Sequence[SpanSight], near_m: float) -> list[Place]:
    """Return the places of conductors that spans with the same structures have in common.

    near_m: within which the lines of one conductor lie, in frames that are aligned.
    """
    pool = _Pool(sights, near_m)
    places: list[Place] = []
    taken: list[Ints] = []
    n_failures = 0
    while len(places) < _MAX_CONDUCTORS and n_failures < _MAX_FAILURES and pool.is_open.any():
        place, own = pool.take_best()
        if not pool.is_steady(own):
            n_failures += 1
        elif all(pool.is_other(own, other, theirs) for other, theirs in zip(places, taken, strict=True)):
            places.append(place)
            taken.append(own)
    return sorted(places, key=lambda place: place.across_m)


class _Pool:
    """The lines of several spans, of which those of found places are taken out.

    is_open (L,): lines that are left. across_m, by_height (L,): where a line lies at the nominal height, and
    by how much that changes for each metre above it. line, key (C,): of crossings, in ascending order; the
    key is of the frame and the bin.
    """

    def __init__(self, sights: Sequence[SpanSight], near_m: float) -> None:
        self.near_m = near_m
        self.n_bins = max(len(one.axis.centres) for one in sights)
        n_lines = np.cumsum([0, *(len(one.lines) for one in sights)])
        n_frames = np.cumsum([0, *(len(one.rows) for one in sights)])
        fine = [np.flatnonzero(one.fine[one.view.frame, one.view.bin]) for one in sights]
        pairs = list(zip(sights, fine, strict=True))
        line = np.concatenate([one.view.line[own] + n_lines[i] for i, (one, own) in enumerate(pairs)])
        order = np.argsort(line, kind="stable")
        frame = np.concatenate([one.view.frame[own] + n_frames[i] for i, (one, own) in enumerate(pairs)])
        bins = np.concatenate([one.view.bin[own] for one, own in pairs])
        self.line, self.key = line[order], (frame * self.n_bins + bins)[order]
        self.span = np.repeat(np.arange(len(sights)), [len(one.rows) for one in sights])
        self.counts = np.bincount(line, minlength=n_lines[-1])
        low, high = (
            self._by_line(np.concatenate([one.at_height(e, 0.0)[own] for one, own in pairs])[order])
            for e in (0.0, 1.0)
        )
        self.across_m, self.by_height = low, high - low
        self.is_open = (self.counts > 0) & (np.abs(self._at(_HEIGHTS_M)) <= _REACH_M - near_m).all(axis=0)
        self.views = np.zeros((len(sights), self.n_bins))
        for i, one in enumerate(sights):
            self.views[i, : len(one.axis.centres)] = one.fine.sum(axis=0)

    def _by_line(self, across_m: Floats) -> Floats:
        """Return the mean of crossings (C,) of each line (L,)."""
        sums = np.bincount(self.line, across_m, len(self.counts))
        return np.asarray(sums / np.maximum(self.counts, 1))

    def _at(self, raised_m: Floats) -> Floats:
        """Return where (H, L) lines lie at some heights (H,)."""
        return np.asarray(self.across_m + np.multiply.outer(raised_m, self.by_height))

    def take_best(self) -> tuple[Place, Ints]:
        """Return the place that explains most of what is left, and the crossings of its lines, taken out."""
        n_cells = round(2 * _REACH_M / _CELL_M)
        left = np.flatnonzero(self.is_open)
        cells = np.round((self._at(_HEIGHTS_M)[:, left] + _REACH_M) / _CELL_M).astype(np.int64)
        votes = np.stack([np.bincount(one, self.counts[left], n_cells) for one in cells])
        votes = gaussian_filter1d(votes, self.near_m / 2 / _CELL_M, axis=1)
        most = votes.max(axis=1)
        good = np.flatnonzero(most >= _NOT_WORSE * most.max())
        height = int(good[np.argmin(np.abs(_HEIGHTS_M[good]))])
        centre_m = float(votes[height].argmax() * _CELL_M - _REACH_M)
        place = self._improve(Place(centre_m, float(_HEIGHTS_M[height])))
        away = np.abs(self._away(place))
        crossings = self._nearest(np.flatnonzero(self.is_open & (away <= self.near_m)), away)
        if not len(crossings):
            crossings = np.flatnonzero(self.line == left[np.argmin(away[left])])
        self.is_open[self.line[crossings]] = False
        return place, crossings

    def _away(self, place: Place) -> Floats:
        """Return how far (L,) lines are from a place, at its height."""
        return np.asarray(self.across_m + place.raised_m * self.by_height - place.across_m)

    def _improve(self, place: Place) -> Place:
        """Return a place moved to where the lines near it meet: it was found on a coarse grid of heights."""
        start_m = place.raised_m
        for _ in range(_ITERATIONS):
            away = self._away(place)
            near_m = self.near_m + _STEP_M / 2 * np.abs(self.by_height - np.median(self.by_height))
            own = np.flatnonzero(self.is_open & (np.abs(away) <= near_m))
            if not len(own):
                return place
            terms = np.column_stack((-np.ones(len(own)), self.by_height[own]))
            weighted = terms * self.counts[own, np.newaxis] / self.near_m**2
            known = np.diag((0.0, (_STEP_M / 2) ** -2.0))  # of the height: near that on the grid
            off = known @ (0.0, start_m - place.raised_m)
            step = np.linalg.solve(weighted.T @ terms + known, off - weighted.T @ away[own])
            place = Place(place.across_m + float(step[0]), place.raised_m + float(step[1]))
        return place

    def _nearest(self, lines: Ints, away: Floats) -> Ints:
        """Return the crossings of those lines of which most are the nearest one of their frame and bin."""
        chosen = np.zeros(len(self.counts), bool)
        chosen[lines] = True
        rows = np.flatnonzero(chosen[self.line])
        order = rows[np.lexsort((away[self.line[rows]], self.key[rows]))]
        _, first = np.unique(self.key[order], return_index=True)
        wins = np.bincount(self.line[order[first]], minlength=len(self.counts))
        chosen &= wins > self.counts / 2
        return np.flatnonzero(chosen[self.line])

    def is_steady(self, own: Ints) -> bool:
        """Return whether enough frames have a conductor there along some metres of half of the spans."""
        frame, bins = np.divmod(np.unique(self.key[own]), self.n_bins)
        seen = np.bincount(self.span[frame] * self.n_bins + bins, minlength=self.views.size)
        seen = seen.reshape(self.views.shape)
        steady = (seen >= _MIN_SHARE * self.views) & (seen >= _MIN_VIEWS)
        n_steady = int(np.count_nonzero(steady.sum(axis=1) >= _MIN_BINS))
        n_seen = int(np.count_nonzero((self.views >= _MIN_VIEWS).sum(axis=1) >= _MIN_BINS))
        return bool(n_steady >= max(1, n_seen // 2))

    def is_other(self, own: Ints, other: Place, theirs: Ints) -> bool:
        """Return whether crossings are of another conductor than those of a known one.

        They are if frames show both at once, or if they lie far away.
        """
        if np.median(np.abs(self._away(other)[self.line[own]])) > _SEPARATE_M:
            return True
        mine = np.unique(self.key[own])
        return len(np.intersect1d(mine, self.key[theirs])) >= _MIN_TOGETHER * len(mine)
