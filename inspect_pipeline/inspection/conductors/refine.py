"""Refine the places of conductors and the alignment of frames together, by least squares.

What a frame shows of a conductor is linear in the errors of its pose, and in where the conductor hangs: so
both are solved for at once, in rounds, between which lines are assigned to conductors anew.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from inspect_pipeline.inspection.conductors.corrected import correct_cameras
from inspect_pipeline.inspection.conductors.layout import Place
from inspect_pipeline.inspection.conductors.matching import NO_CONDUCTOR, match_lines

if TYPE_CHECKING:
    from collections.abc import Sequence

    from inspect_pipeline.arrays import Floats, Ints
    from inspect_pipeline.inspection.conductors.sight import SpanSight

_ROUNDS = 4
_LINE_NOISE_M, _LINE_NOISE_PX = 0.08, 2.0  # of a line in a frame; its crossings share errors
# Standard deviations of places: height and sag, of one conductor about the mean of all, and of that mean.
_MOST_SAG_M = 0.75  # by which the sag of a conductor on all spans differs from that of the others
_OWN_SD_M, _MEAN_SD_M = np.array([2.0, 0.4]), np.array([0.5, 0.4])
# Bounds of standard deviations of pose errors: shift in m, turn in m per m, scale, those by distance aside.
_LEAST_SD = np.array([0.1, 0.003, 0.01, 0.0003, 0.0003])
_MOST_SD = np.array([2.0, 0.05, 0.15, 0.003, 0.003])
# Those expected once lines are matched: from small ones, turns about the other two axes would hardly grow.
FREE_SD = np.array([0.3, 0.03, 0.05, 0.003, 0.003])
_MEDIAN_TO_SD = 1.4826
_NEAR_M, _NEAR_SD = 0.5, 4.0  # of where a conductor appears: lines farther away belong to one that was moved
_EXPLAINED_M, _EXPLAINED_PX = 0.15, 5.0
_MIN_FRAMES_SHARE = 0.35  # of a span, in which a conductor is found that the span has
_SAME_M, _MIN_TOGETHER = 0.6, 0.3  # nearer places are two only where frames have lines of both


@dataclass(frozen=True, eq=False)
class _Matches:
    """Crossings of one span with a conductor: rows of crossings, their conductors and weights."""

    rows: Ints
    places: Ints
    weights: Floats


def refine(
    raw: Sequence[SpanSight],
    aligned: Sequence[SpanSight],
    places: Sequence[Place],
    least_sd: Floats = _LEAST_SD,
) -> tuple[list[SpanSight], list[Place]]:
    """Return the sights of spans, better aligned, and the places of their conductors, without doubles.

    raw: as recorded. aligned: the same, aligned well enough to match lines with places. least_sd (5,): of
    pose errors that are expected at first.
    """
    sights, places = list(aligned), list(places)
    corrections = [_first_corrections(one, other) for one, other in zip(raw, aligned, strict=True)]
    sd = np.maximum(_usual_sd(corrections, [np.zeros_like(one) for one in corrections]), least_sd)
    for _ in range(_ROUNDS):
        matches = [_match(one, places) for one in sights]
        corrections, places, variances = _solve(sights, matches, corrections, places, sd)
        sd = _usual_sd(corrections, variances)
        sights = [_apply(one, found) for one, found in zip(raw, corrections, strict=True)]
        places = _merge(places, sights)
    places = _drop_rare(places, sights)
    return [_with_noise(one, places, float(sd[0])) for one in sights], places


def _first_corrections(raw: SpanSight, aligned: SpanSight) -> Floats:
    """Return the corrections (N, 5) that a first alignment has made: shift, turn and scale."""
    frame, n_frames = raw.view.frame, len(raw.rows)
    corrections = np.zeros((n_frames, len(_MOST_SD)))
    corrections[:, 0] = np.nan_to_num(aligned.side_m - raw.side_m)
    corrections[:, 2] = np.nan_to_num((aligned.above_m / raw.above_m - 1)[:, 0])
    by_pose = _by_pose(raw)
    left = aligned.view.across_m - raw.view.across_m - (by_pose * corrections[frame]).sum(axis=1)
    total = np.bincount(frame, by_pose[:, 1] ** 2, n_frames)
    corrections[:, 1] = np.bincount(frame, by_pose[:, 1] * left, n_frames) / np.maximum(total, 1e-9)
    return corrections


def _usual_sd(corrections: Sequence[Floats], variances: Sequence[Floats]) -> Floats:
    """Return the standard deviation (5,) of pose errors by corrections and their variances, within bounds."""
    squares = np.concatenate([known**2 + left for known, left in zip(corrections, variances, strict=True)])
    is_known = np.concatenate(corrections).any(axis=1)
    sd = np.sqrt(np.mean(squares[is_known], axis=0)) if is_known.any() else _LEAST_SD
    return np.asarray(np.clip(sd, _LEAST_SD, _MOST_SD))


def _with_noise(sight: SpanSight, places: Sequence[Place], shift_sd_m: float) -> SpanSight:
    """Return the sight with the noise of its lines, and that of positions, at least that known before."""
    found = _match(sight, places)
    line = sight.view.line[found.rows]
    counts, sums_m = np.bincount(line), np.bincount(line, _residuals(sight, found, places))
    away_m = np.abs(sums_m[counts > 0] / counts[counts > 0])
    noise_m = _MEDIAN_TO_SD * float(np.median(away_m)) if len(away_m) else sight.noise_m
    return replace(sight, noise_m=noise_m, shift_sd_m=max(sight.shift_sd_m, shift_sd_m))


def share_explained(sights: Sequence[SpanSight], places: Sequence[Place]) -> float:
    """Return the share of crossings that are near where the conductor of their line appears."""
    n_all, n_near = 0, 0
    for sight in sights:
        found = _match(sight, places) if places else None
        n_all += int(sight.fine[sight.view.frame, sight.view.bin].sum())
        if found:
            scale_px = sight.scale_px[sight.view.frame[found.rows], sight.view.bin[found.rows]]
            near_m = np.hypot(_EXPLAINED_M, _EXPLAINED_PX / scale_px)
            n_near += int(np.count_nonzero(np.abs(_residuals(sight, found, places)) <= near_m))
    return n_near / max(n_all, 1)


def _match(sight: SpanSight, places: Sequence[Place]) -> _Matches:
    """Return the crossings of lines with conductors, weighted by how well they fit."""
    view = sight.view
    owner = match_lines(sight, places)[view.line]
    rows = np.flatnonzero((owner != NO_CONDUCTOR) & sight.fine[view.frame, view.bin])
    found = _Matches(rows, owner[rows], np.ones(len(rows)))
    if not len(rows):
        return found
    away = np.abs(_residuals(sight, found, places))
    near_m = np.clip(_NEAR_SD * _MEDIAN_TO_SD * float(np.median(away)), _LINE_NOISE_M, _NEAR_M)
    fits = np.clip(1 - (away / (2 * near_m)) ** 2, 0.0, 1.0) ** 2
    line = view.line[rows]
    counts = np.bincount(line)[line]
    noise_m = np.hypot(_LINE_NOISE_M, _LINE_NOISE_PX / sight.scale_px[view.frame[rows], view.bin[rows]])
    return replace(found, weights=fits / counts / noise_m**2)


def _residuals(sight: SpanSight, found: _Matches, places: Sequence[Place]) -> Floats:
    """Return by how much crossings are off from where their conductors appear."""
    appears = np.zeros(len(found.rows))
    for k, place in enumerate(places):
        own = found.places == k
        appears[own] = predict_across(sight, found.rows[own], place)[0]
    return np.asarray(sight.view.across_m[found.rows] - appears)


def predict_across(sight: SpanSight, rows: Ints, place: Place) -> tuple[Floats, Floats]:
    """Return where a conductor appears across at crossings, and the derivatives (C, 3) by its parameters."""
    frame, bins = sight.view.frame[rows], sight.view.bin[rows]
    above_m, parabola, side_m = sight.above_m[frame, bins], sight.parabola[bins], sight.side_m[frame]
    depth_m = np.maximum(above_m - place.raised_m + place.sag_m * parabola, 1.0)
    ratio, away_m = above_m / depth_m, place.across_m - side_m
    by_height = away_m * ratio / depth_m
    return side_m + away_m * ratio, np.column_stack((ratio, by_height, -by_height * parabola))


def _by_pose(sight: SpanSight) -> Floats:
    """Return by what pose errors move crossings: (C, 5)."""
    frame = sight.view.frame
    ahead_m = sight.axis.bins_m[sight.view.bin] - sight.from_m[frame]
    aside_m = sight.view.across_m - sight.side_m[frame]
    return np.column_stack((np.ones_like(ahead_m), ahead_m, aside_m, ahead_m * aside_m, aside_m**2))


def _solve(
    sights: Sequence[SpanSight],
    matches: Sequence[_Matches],
    corrections: Sequence[Floats],
    places: Sequence[Place],
    sd: Floats,
) -> tuple[list[Floats], list[Place], list[Floats]]:
    """Return better corrections (N, 5) of the frames of each span, places, and variances of the corrections.

    The corrections of each frame are eliminated first, which leaves equations for the places alone.
    """
    now = np.array([(place.across_m, place.raised_m, place.sag_m) for place in places])
    normal = _prior(len(places))
    right = -normal @ now.ravel()
    gains, variances = [], []
    for sight, found, known in zip(sights, matches, corrections, strict=True):
        by_frame, mixed, wanted, own, own_wanted = _equations(sight, found, known, places)
        by_frame += np.diag(sd**-2.0)
        wanted -= known / sd**2
        gain = np.linalg.solve(by_frame, np.concatenate((mixed, wanted[:, :, np.newaxis]), axis=2))
        normal += own - np.einsum("nip,niq->pq", mixed, gain[:, :, :-1])
        right += own_wanted - np.einsum("nip,ni->p", mixed, gain[:, :, -1])
        gains.append(gain)
        variances.append(np.einsum("nii->ni", np.linalg.inv(by_frame)))
    step = np.linalg.solve(normal, right)
    better = [
        known + gain[:, :, -1] - gain[:, :, :-1] @ step
        for known, gain in zip(corrections, gains, strict=True)
    ]
    values = now + step.reshape(-1, 3)
    # Another shape than that of a hanging wire is one that a neighbour was moved to, and not a sag.
    usual_m = np.median(values[:, 2])
    values[:, 2] = np.clip(values[:, 2], usual_m - _MOST_SAG_M, usual_m + _MOST_SAG_M)
    return better, [Place(*three) for three in values.tolist()], variances


def _equations(
    sight: SpanSight, found: _Matches, corrections: Floats, places: Sequence[Place]
) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Return normal equations of corrections (N, 5, 5) and mixed ones (N, 5, 3K), right-hand sides (N, 5).

    Further those of places (3K, 3K), and their right-hand side (3K,). Residuals are those of the lines as
    recorded: if they were those of scaled lines, smaller scales would seem to fit better.
    """
    n_frames, n_terms, n_values = len(sight.rows), corrections.shape[1], 3 * len(places)
    by_frame, wanted = np.zeros((n_frames, n_terms, n_terms)), np.zeros((n_frames, n_terms))
    mixed, own = np.zeros((n_frames, n_terms, n_values)), np.zeros((n_values, n_values))
    own_wanted = np.zeros(n_values)
    by_pose = _by_pose(sight)
    for k, place in enumerate(places):
        chosen = found.places == k
        rows, weights = found.rows[chosen], found.weights[chosen, np.newaxis]
        frame = sight.view.frame[rows]
        appears, by_place = predict_across(sight, rows, place)
        _, ahead_m, aside_m = (by_pose[rows, i] for i in range(3))
        c = corrections[frame]
        scale = np.maximum(1 + c[:, 2] + ahead_m * c[:, 3] + 2 * aside_m * c[:, 4], 0.5)[:, np.newaxis]
        off_m = (sight.view.across_m[rows] - appears)[:, np.newaxis] / scale
        ratio, aside_m = by_place[:, 0], appears - sight.side_m[frame]
        pose = -np.column_stack((ratio, ahead_m, ratio * aside_m, ahead_m * aside_m, aside_m**2)) / scale
        place_terms = by_place / scale
        values = slice(3 * k, 3 * k + 3)
        own[values, values] = (weights * place_terms).T @ place_terms
        own_wanted[values] = ((weights * off_m).T @ place_terms)[0]
        _add(by_frame, frame, pose, weights * pose)
        _add(mixed[:, :, values], frame, pose, weights * place_terms)
        _add(wanted[:, :, np.newaxis], frame, pose, weights * off_m)
    return by_frame, mixed, wanted, own, own_wanted


def _add(sums: Floats, frame: Ints, left: Floats, right: Floats) -> None:
    """Add the products of two sets of columns (C, I) and (C, J) to the sums (N, I, J) of their frames."""
    for i in range(left.shape[1]):
        for j in range(right.shape[1]):
            sums[:, i, j] += np.bincount(frame, left[:, i] * right[:, j], len(sums))


def _prior(n_places: int) -> Floats:
    """Return the normal equations (3K, 3K) of what is expected of heights and sags."""
    normal = np.zeros((n_places, 3, n_places, 3))
    mean = np.full((n_places, n_places), 1 / n_places)
    normal[:, 0, :, 0] = np.eye(n_places) * 1e-6
    for i, (own_m, mean_m) in enumerate(zip(_OWN_SD_M, _MEAN_SD_M, strict=True), start=1):
        normal[:, i, :, i] = (np.eye(n_places) - mean) / own_m**2 + mean / mean_m**2
    return normal.reshape(3 * n_places, -1)


def _apply(sight: SpanSight, corrections: Floats) -> SpanSight:
    """Return the sight with its lines and cameras moved."""
    moved_m = (_by_pose(sight) * corrections[sight.view.frame]).sum(axis=1)
    moved = sight.move(sight.view.across_m + moved_m, corrections[:, 0], 1 + corrections[:, 2])
    return replace(moved, cameras=correct_cameras(sight, corrections))


def _merge(places: Sequence[Place], sights: Sequence[SpanSight]) -> list[Place]:
    """Drop each place near another one that has more lines, where frames do not show lines of both."""
    present = [frames_with(one, places) for one in sights]
    has = np.concatenate(present) if present else np.zeros((0, len(places)), bool)
    kept: list[int] = []
    for k in np.argsort(-has.sum(axis=0), kind="stable").tolist():
        near = [j for j in kept if _distance_m(places[k], places[j], sights) < _SAME_M]
        together = [np.count_nonzero(has[:, k] & has[:, j]) for j in near]
        if has[:, k].any() and all(n >= _MIN_TOGETHER * has[:, k].sum() for n in together):
            kept.append(k)
    return sorted((places[k] for k in kept), key=lambda place: place.across_m)


def _drop_rare(places: Sequence[Place], sights: Sequence[SpanSight]) -> list[Place]:
    """Drop places that less than half of the spans have: there, a conductor hangs elsewhere than usual.

    Spans that the flight only touches have no voice.
    """
    n_frames = np.array([int(one.fine.any(axis=1).sum()) for one in sights])
    shown = [one for one, n in zip(sights, n_frames, strict=True) if n > 0 and 2 * n >= n_frames.max()]
    shares = np.array([frames_with(one, places).sum(axis=0) / one.fine.any(axis=1).sum() for one in shown])
    has = (shares.reshape(len(shown), len(places)) >= _MIN_FRAMES_SHARE).sum(axis=0)
    return [place for place, n_spans in zip(places, has.tolist(), strict=True) if 2 * n_spans >= len(shown)]


def frames_with(sight: SpanSight, places: Sequence[Place]) -> np.ndarray:
    """Return which frames have a line of which conductor (N, K)."""
    owner = match_lines(sight, places)
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
