"""Refine the places of conductors and the alignment of frames together, by least squares in turns."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from inspect_pipeline.inspection.conductors.votes import NO_CONDUCTOR, assign_lines

if TYPE_CHECKING:
    from collections.abc import Sequence

    from inspect_pipeline.arrays import Floats, Ints
    from inspect_pipeline.inspection.conductors.layout import Place
    from inspect_pipeline.inspection.conductors.sight import SpanSight

_ROUNDS = 5
_LINE_NOISE_M = 0.1  # of the lines of a conductor in a frame
_RAISED_SD_M, _SAG_SD_M = 2.0, 1.0  # of heights and sag about the nominal ones
# Standard deviations of pose errors: shift in m, turn in m per m, scale, and turn by distance aside. They are
# taken from the corrections themselves, within bounds.
_LEAST_SD, _MOST_SD = np.array([0.1, 0.003, 0.01, 0.0003]), np.array([2.0, 0.05, 0.12, 0.003])
_MEDIAN_TO_SD = 1.4826
_NEAR_M = 0.5  # of where a conductor appears: lines farther away belong to one that was moved
_MIN_CONDUCTORS = 2  # of a frame that is aligned
_SAME_M, _MIN_TOGETHER = 0.6, 0.3  # nearer places are two only where frames have lines of both


@dataclass(frozen=True, eq=False)
class _Matches:
    """Crossings of one span with a conductor: rows of crossings, and their conductors."""

    rows: Ints
    places: Ints


def refine(
    raw: Sequence[SpanSight], aligned: Sequence[SpanSight], places: Sequence[Place]
) -> tuple[list[SpanSight], list[Place]]:
    """Return the sights of spans, better aligned, and the places of their conductors, without doubles.

    raw: as recorded. aligned: the same, aligned well enough to match lines with places.
    """
    sights, places, sd = list(aligned), list(places), _first_sd(raw, aligned)
    for _ in range(_ROUNDS):
        matches = [_match(one, places) for one in sights]
        corrections = [_correct(one, found, places, sd) for one, found in zip(raw, matches, strict=True)]
        known = np.concatenate(corrections)
        known = known[known.any(axis=1)]
        if len(known):  # what all frames have in common is no error of single poses
            sd = np.clip(_MEDIAN_TO_SD * np.median(np.abs(known), axis=0), _LEAST_SD, _MOST_SD)
            corrections = [one - np.median(known, axis=0) for one in corrections]
        sights = [_apply(one, found) for one, found in zip(raw, corrections, strict=True)]
        places = [_fit(k, place, sights, matches) for k, place in enumerate(places)]
        places = _centre(_merge(places, sights), sights)
    return [_with_noise(one, places, float(sd[0])) for one in sights], places


def _first_sd(raw: Sequence[SpanSight], aligned: Sequence[SpanSight]) -> Floats:
    """Return the standard deviation of corrections by how far the first alignment moved frames."""
    pairs = [(one, other) for one, other in zip(raw, aligned, strict=True) if len(one.rows)]
    shift_m = np.concatenate([np.abs(other.side_m - one.side_m) for one, other in pairs])
    scale = np.concatenate([np.abs(other.above_m / one.above_m - 1)[:, 0] for one, other in pairs])
    moved = _MEDIAN_TO_SD * np.array([np.nanmedian(shift_m), np.nanmedian(scale)])
    share = np.clip(moved / _MOST_SD[[0, 2]], 0.0, 1.0).max()
    return np.asarray(np.maximum(share * _MOST_SD, 2 * _LEAST_SD))


def _with_noise(sight: SpanSight, places: Sequence[Place], shift_sd_m: float) -> SpanSight:
    """Return the sight with the noise of its crossings and positions."""
    found = _match(sight, places)
    away = [
        np.abs(sight.view.across_m[rows] - predict_across(sight, rows, place)[0])
        for k, place in enumerate(places)
        if len(rows := found.rows[found.places == k])
    ]
    noise_m = _MEDIAN_TO_SD * float(np.median(np.concatenate(away))) if away else sight.noise_m
    return replace(sight, noise_m=noise_m, shift_sd_m=shift_sd_m)


def _match(sight: SpanSight, places: Sequence[Place]) -> _Matches:
    owner = assign_lines(sight, places)[sight.view.line]
    is_fine = sight.fine[sight.view.frame, sight.view.bin]
    rows = np.flatnonzero((owner != NO_CONDUCTOR) & is_fine)
    return _Matches(rows, owner[rows])


def predict_across(sight: SpanSight, rows: Ints, place: Place) -> tuple[Floats, Floats]:
    """Return where a conductor appears across at crossings, and the derivatives (C, 3) by its parameters."""
    frame, bins = sight.view.frame[rows], sight.view.bin[rows]
    above_m, parabola, side_m = sight.above_m[frame, bins], sight.parabola[bins], sight.side_m[frame]
    depth_m = np.maximum(above_m - place.raised_m + place.sag_m * parabola, 1.0)
    ratio, away_m = above_m / depth_m, place.across_m - side_m
    by_height = away_m * ratio / depth_m
    return side_m + away_m * ratio, np.column_stack((ratio, by_height, -by_height * parabola))


def _terms(sight: SpanSight) -> Floats:
    """Return by what pose errors move crossings: (C, 4)."""
    frame = sight.view.frame
    ahead_m = sight.axis.bins_m[sight.view.bin] - sight.from_m[frame]
    aside_m = sight.view.across_m - sight.side_m[frame]
    return np.column_stack((np.ones_like(ahead_m), ahead_m, aside_m, ahead_m * aside_m))


def _correct(sight: SpanSight, found: _Matches, places: Sequence[Place], sd: Floats) -> Floats:
    """Return corrections (N, 4) that move the lines of each frame to where their conductors appear."""
    wanted = np.zeros(len(found.rows))
    for k, place in enumerate(places):
        own = found.places == k
        wanted[own] = predict_across(sight, found.rows[own], place)[0]
    residuals, terms = wanted - sight.view.across_m[found.rows], _terms(sight)[found.rows]
    frame = sight.view.frame[found.rows]
    corrections = np.zeros((len(sight.rows), terms.shape[1]))
    order = np.argsort(frame, kind="stable")
    for group in np.split(order, np.flatnonzero(np.diff(frame[order])) + 1):
        n_conductors = len(np.unique(found.places[group]))
        if n_conductors < _MIN_CONDUCTORS:
            continue
        near = group[np.abs(residuals[group] - np.median(residuals[group])) < _NEAR_M]
        weight = n_conductors / len(group) / _LINE_NOISE_M**2
        normal = weight * terms[near].T @ terms[near] + np.diag(sd**-2.0)
        corrections[frame[group[0]]] = np.linalg.solve(normal, weight * terms[near].T @ residuals[near])
    return corrections


def _apply(sight: SpanSight, corrections: Floats) -> SpanSight:
    """Return the sight with its lines and cameras moved."""
    moved_m = (_terms(sight) * corrections[sight.view.frame]).sum(axis=1)
    return sight.move(sight.view.across_m + moved_m, corrections[:, 0], 1 + corrections[:, 2])


def _fit(k: int, place: Place, sights: Sequence[SpanSight], matches: Sequence[_Matches]) -> Place:
    """Return the place of a conductor, fitted to its crossings in all spans, each frame with equal weight."""
    normal, right = np.diag([1e-6, _RAISED_SD_M**-2.0, _SAG_SD_M**-2.0]), np.zeros(3)
    right -= normal @ (0.0, place.raised_m, place.sag_m)
    for sight, found in zip(sights, matches, strict=True):
        rows = found.rows[found.places == k]
        if not len(rows):
            continue
        appears, terms = predict_across(sight, rows, place)
        residuals = sight.view.across_m[rows] - appears
        near = np.abs(residuals) < _NEAR_M
        rows, terms, residuals = rows[near], terms[near], residuals[near]
        frames = sight.view.frame[rows]
        weight = 1 / np.maximum(np.bincount(frames, minlength=len(sight.rows))[frames], 1)
        weighted = terms * weight[:, np.newaxis] / _LINE_NOISE_M**2
        normal += weighted.T @ terms
        right += weighted.T @ residuals
    step = np.linalg.solve(normal, right)
    return replace(
        place,
        across_m=place.across_m + float(step[0]),
        raised_m=float(np.clip(place.raised_m + step[1], -6, 6)),
        sag_m=float(np.clip(place.sag_m + step[2], -3, 6)),
    )


def _centre(places: Sequence[Place], sights: Sequence[SpanSight]) -> list[Place]:
    """Move all places along their lines of sight until their mean height is the nominal one.

    Views from one side know heights relative to each other far better than from the camera.
    """
    if not places:
        return []
    mean_m = float(np.mean([place.raised_m for place in places]))
    side_m = np.concatenate([one.side_m for one in sights])
    above_m = np.concatenate([one.above_m.mean(axis=1) for one in sights])
    slopes = [float(np.nanmedian((place.across_m - side_m) / above_m)) for place in places]
    return [
        replace(place, across_m=place.across_m + slope * mean_m, raised_m=place.raised_m - mean_m)
        for place, slope in zip(places, slopes, strict=True)
    ]


def _merge(places: Sequence[Place], sights: Sequence[SpanSight]) -> list[Place]:
    """Drop each place near another one that has more lines, where frames do not show lines of both."""
    present = [_frames_with(one, places) for one in sights]
    has = np.concatenate(present) if present else np.zeros((0, len(places)), bool)
    kept: list[int] = []
    for k in np.argsort(-has.sum(axis=0), kind="stable").tolist():
        near = [j for j in kept if _distance_m(places[k], places[j], sights) < _SAME_M]
        together = [np.count_nonzero(has[:, k] & has[:, j]) for j in near]
        if has[:, k].any() and all(n >= _MIN_TOGETHER * has[:, k].sum() for n in together):
            kept.append(k)
    return sorted((places[k] for k in kept), key=lambda place: place.across_m)


def _frames_with(sight: SpanSight, places: Sequence[Place]) -> np.ndarray:
    """Return which frames have a line of which conductor (N, K)."""
    owner = assign_lines(sight, places)
    has = np.zeros((len(sight.rows), len(places)), bool)
    owned = np.flatnonzero(owner != NO_CONDUCTOR)
    has[sight.lines.frame[owned], owner[owned]] = True
    return has


def _distance_m(first: Place, second: Place, sights: Sequence[SpanSight]) -> float:
    """Return how far two conductors appear from each other, as a median over frames and bins."""
    apart = [
        np.abs(
            one.appear_at(first.across_m, first.raised_m, first.sag_m)
            - one.appear_at(second.across_m, second.raised_m, second.sag_m)
        )[one.fine]
        for one in sights
    ]
    values = np.concatenate(apart) if apart else np.zeros(0)
    return float(np.median(values)) if len(values) else np.inf
