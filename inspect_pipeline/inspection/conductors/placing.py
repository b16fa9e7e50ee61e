"""Find the conductors of spans in space: by frames aligned as patterns, or as recorded."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from inspect_pipeline.inspection.conductors.alignment import align_spans
from inspect_pipeline.inspection.conductors.layout import Place, find_places
from inspect_pipeline.inspection.conductors.realign import realign
from inspect_pipeline.inspection.conductors.refine import FREE_SD, frames_with, refine, share_explained
from inspect_pipeline.inspection.conductors.sight import look_at_span

if TYPE_CHECKING:
    from collections.abc import Sequence

    from inspect_pipeline.arrays import Ints, Mask
    from inspect_pipeline.inspection.conductors.sight import SpanSight
    from inspect_pipeline.inspection.rules import Rules

# Within which the lines of a conductor lie, from frames that are aligned roughly to those aligned well.
_NEAR_M = (0.2, 0.1)
_NEAR_RAW_M = (0.5, 0.25, 0.1)
_BUNDLE_M = 0.6  # between wires of a bundle
_MAX_MIXED_M, _MIN_TOGETHER = 3.0, 0.3
_LOST_SD_M = 1.0  # of positions of frames that could not be aligned
_MOST_SUPERFLUOUS, _MAX_LOST = 4, 0.01  # places that are tried without; of what is explained
_LEAST, _ENOUGH = 0.75, 0.95  # of the crossings that an alignment explains: else it is wrong; if it is good
# Below this share, conductors are looked for by parts of the frames, of not more than so many, in rounds.
_HARD, _N_PARTS, _ENOUGH_FRAMES, _N_PARTS_ROUNDS = 0.9, 4, 40, 2
_FAR = 2.0  # times the usual reach: of frames that are not aligned yet


class Placing(NamedTuple):
    """Sights of spans with the same structures, aligned to each other, and the places of their conductors.

    explained: share of what lines show along the spans that these conductors explain.
    """

    sights: list[SpanSight]
    places: list[Place]
    explained: float


def place_conductors(raw: Sequence[SpanSight], rules: Rules) -> Placing:
    """Return the sights of spans with the same structures, aligned, and the places of their conductors.

    From one side, conductors form a pattern that errors of poses shift and scale. From all sides they do not:
    then frames are taken as recorded at first. What explains more lines is right. Where poses have errors,
    frames are looked at once more by the corrected cameras: what is in view, which part of the span a line is
    at.
    """
    if not any(len(one.view.across_m) for one in raw):
        return Placing(list(raw), [], 0.0)
    best = _place(raw, align_spans(raw), _NEAR_M)
    if best.explained < _ENOUGH:
        best = max(best, _place(raw, raw, _NEAR_RAW_M), key=lambda found: found.explained)
    if best.explained < _HARD:
        best = max(best, _place_by_parts(raw, rules), key=lambda found: found.explained)
    if best.explained < _LEAST:
        sights = [replace(one, shift_sd_m=max(one.shift_sd_m, _LOST_SD_M)) for one in best.sights]
        return best._replace(sights=sights)
    if all(one.is_exact for one in best.sights):
        return _without_superfluous(raw, best)
    seen = [_look_again(one, rules) for one in best.sights]
    sights, places = refine(seen, seen, best.places, FREE_SD)
    again = Placing(sights, places, share_explained(sights, places))
    if again.explained < best.explained - _MAX_LOST:
        return _without_superfluous(raw, best)
    return _without_superfluous(seen, again)


def _place_by_parts(raw: Sequence[SpanSight], rules: Rules) -> Placing:
    """Return the conductors that a part of the frames shows, by which all frames are then aligned.

    Frames taken one after the other see conductors from nearly the same side, as a pattern.
    """
    thinned = [_thin_out(one) for one in raw]
    found = []
    for part in range(_N_PARTS):
        some = [_take_part(one, part) for one in thinned]
        places = _place(some, align_spans(some), _NEAR_M).places
        if places:
            found.append(_align_by(thinned, places))
    if not found:
        return Placing(list(raw), [], 0.0)
    best = _align_by(raw, max(found, key=lambda one: one.explained).places)
    for _ in range(_N_PARTS_ROUNDS):
        if not best.places:
            break
        seen = [_look_again(one, rules) for one in best.sights]
        better = _align_by(seen, best.places)
        again = _place(seen, better.sights, _NEAR_M[-1:])
        best = max(best, better, again, key=lambda one: one.explained)
    return best


def _align_by(sights: Sequence[SpanSight], places: Sequence[Place]) -> Placing:
    """Return frames aligned by conductors, from anywhere near."""
    shifted = [realign(one, places, _FAR) for one in sights]
    moved, better = refine(sights, shifted, places, FREE_SD)
    return Placing(moved, better, share_explained(moved, better))


def _thin_out(sight: SpanSight) -> SpanSight:
    """Return the sight with no more frames than needed to look for conductors."""
    seen = np.flatnonzero(sight.fine.any(axis=1))
    kept = np.unique(np.linspace(0, max(len(seen) - 1, 0), _ENOUGH_FRAMES).round().astype(np.int64))
    return _take_frames(sight, seen[kept] if len(seen) else seen)


def _take_part(sight: SpanSight, part: int) -> SpanSight:
    """Return the sight with one of several parts of the frames that show the span."""
    return _take_frames(sight, np.array_split(np.flatnonzero(sight.fine.any(axis=1)), _N_PARTS)[part])


def _take_frames(sight: SpanSight, frames: Ints) -> SpanSight:
    """Return the sight as if other frames showed nothing of the span."""
    is_kept = np.isin(np.arange(len(sight.rows)), frames)
    shown = sight.shown & is_kept[:, np.newaxis]
    return replace(sight, view=sight.view.select(is_kept[sight.view.frame]), shown=shown)


def _look_again(sight: SpanSight, rules: Rules) -> SpanSight:
    """Return what the frames of a sight show of its span by their corrected cameras."""
    again = look_at_span(sight.axis, sight.rows, sight.cameras, sight.lines, rules)
    return replace(again, shift_sd_m=sight.shift_sd_m)


def _without_superfluous(raw: Sequence[SpanSight], found: Placing) -> Placing:
    """Return the conductors without those whose lines the others explain as well, if frames move a little.

    Frames aligned by another wire of a bundle make one more of its wires than there are: at the same side of
    all bundles.
    """
    for _ in range(_MOST_SUPERFLUOUS):
        has = np.concatenate([frames_with(one, found.places) for one in found.sights])
        pairs = _never_together(found.places, has)
        if not pairs:
            break
        sides = [sorted(set(side)) for side in zip(*pairs, strict=True)]
        rarer = min(sides, key=lambda side: has[:, side].sum(axis=0).mean())
        rarest = min((k for pair in pairs for k in pair), key=lambda k: has[:, k].sum())
        tried = [_drop(raw, found, dropped) for dropped in (rarer, [rarest])]
        fewer = max(tried, key=lambda one: one.explained)
        if fewer.explained < found.explained - _MAX_LOST:
            break
        found = fewer
    return found


def _drop(raw: Sequence[SpanSight], found: Placing, dropped: Sequence[int]) -> Placing:
    """Return the conductors without some, frames shifted to the others."""
    left = [place for k, place in enumerate(found.places) if k not in dropped]
    sights, places = refine(raw, [realign(one, left) for one in found.sights], left)
    return Placing(sights, places, share_explained(sights, places))


def _place(raw: Sequence[SpanSight], first: Sequence[SpanSight], near_m: Sequence[float]) -> Placing:
    """Find places and align frames in turns, more and more closely."""
    sights, places = list(first), list[Place]()
    for each_m in near_m:
        places = find_places(sights, each_m)
        if not places:
            break
        sights, places = refine(raw, sights, places)
    return Placing(sights, places, share_explained(sights, places))


def find_mixed(found: Placing) -> Mask:
    """Return which conductors (K,) are mixed up with their neighbours.

    Where some frames are aligned wrongly, by the distance of two wires of a bundle, there is one place more
    than conductors, and no frame has lines at both of its ends. Where much is not explained, all may be.
    """
    if found.explained < _LEAST:
        return np.ones(len(found.places), bool)
    has = np.concatenate([frames_with(one, found.places) for one in found.sights])
    mixed = np.zeros(len(found.places), bool)
    order = np.argsort([place.across_m for place in found.places]).tolist()
    for first, second in _never_together(found.places, has):
        mixed[order[order.index(first) : order.index(second) + 1]] = True
    return _with_bundles(found.places, mixed)


def _never_together(places: Sequence[Place], has: Mask) -> list[tuple[int, int]]:
    """Return the pairs of conductors, from left to right, that hardly any frame (N, K) has lines of both."""
    pairs = []
    order = np.argsort([place.across_m for place in places]).tolist()
    for first, second in combinations(order, 2):
        near = places[second].across_m - places[first].across_m <= _MAX_MIXED_M
        least = min(has[:, first].sum(), has[:, second].sum())
        if near and np.count_nonzero(has[:, first] & has[:, second]) < _MIN_TOGETHER * least:
            pairs.append((first, second))
    return pairs


def _with_bundles(places: Sequence[Place], mixed: Mask) -> Mask:
    """Return the mask (K,) of conductors with the other wires of their bundles."""
    at = np.array([(place.across_m, place.raised_m) for place in places])
    near = np.linalg.norm(at[:, np.newaxis] - at, axis=2) <= _BUNDLE_M
    for _ in range(len(places)):
        mixed = np.asarray(near[mixed].any(axis=0)) | mixed
    return mixed
