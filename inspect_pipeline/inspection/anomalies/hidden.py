"""Whether a conductor could be hidden behind another in all frames that show a span."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from inspect_pipeline.inspection.conductors.votes import apart_px

if TYPE_CHECKING:
    from inspect_pipeline.inspection.conductors.layout import Place
    from inspect_pipeline.inspection.rules import Rules
    from inspect_pipeline.inspection.span_evidence import SpanEvidence

_MIN_PLACES = 2
_MIN_EXPLAINED = 0.95  # of what lines show: what is left may be a conductor without a place
_MIN_SHARE = 0.8  # of the metres in view, along which a hidden conductor would have been seen


def hides_none(one: SpanEvidence, rules: Rules) -> bool:
    """Return whether frames from different sides show that no conductor hides behind another one.

    One is supposed behind and before each known conductor, as far away as the nearest two are from each
    other: it would have been seen beside that one in enough frames.
    """
    places, sight = one.places, one.sight
    in_view = sight.fine.any(axis=0)
    is_exact = sight.is_exact and one.explained >= _MIN_EXPLAINED
    if one.votes is None or len(places) < _MIN_PLACES or not is_exact or not in_view.any():
        return False
    supposed = [other for place in places for other in _behind(one, place, _least_distance_m(places))]
    return all(
        np.mean(_times_seen(one, place, other, rules)[in_view] >= rules.anomalies["min_support"])
        >= _MIN_SHARE
        for place, other in supposed
    )


def _least_distance_m(places: tuple[Place, ...]) -> float:
    """Return the distance of the two nearest conductors."""
    at = np.array([(place.across_m, place.raised_m) for place in places])
    apart = np.linalg.norm(at[:, np.newaxis] - at, axis=2)
    return float(apart[~np.eye(len(at), dtype=bool)].min())


def _behind(one: SpanEvidence, place: Place, away_m: float) -> list[tuple[Place, Place]]:
    """Return a conductor with one before and one behind it, as seen from most frames."""
    seen = one.sight.fine.any(axis=1)
    above_m = one.sight.above_m[seen].mean() - place.raised_m
    ray = np.array([place.across_m - np.median(one.sight.side_m[seen]), -above_m])
    across_m, down_m = away_m * ray / np.linalg.norm(ray)
    return [
        (place, type(place)(place.across_m + sign * across_m, place.raised_m + sign * down_m, place.sag_m))
        for sign in (-1, 1)
    ]


def _times_seen(one: SpanEvidence, place: Place, other: Place, rules: Rules) -> np.ndarray:
    """Return in how many frames (B,) two conductors appear apart."""
    is_apart = apart_px(one.sight, place, other) >= rules.anomalies["aligned_px"]
    return np.asarray((is_apart & one.sight.fine).sum(axis=0))
