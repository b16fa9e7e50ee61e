"""Which parts of a span the rules about conductors judged, and why not the others."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from inspect_pipeline.inspection.poses import NO_PROBLEM, POSE_PROBLEMS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from inspect_pipeline.arrays import Floats, Ints, Mask
    from inspect_pipeline.inspection.rules import Rules
    from inspect_pipeline.inspection.span_view import SpanAxis

# From the best to the worst: over several cameras, the best outcome of a bin counts.
OUTCOMES = (
    "judged",
    "conductors not measured",
    "wires aligned",
    "lines in pieces",
    "too few views",
    "no conductor found",
    "too coarse",
    "not in view",
    *POSE_PROBLEMS,
    "not flown by",
)
JUDGED = OUTCOMES.index("judged")
NOT_MEASURED = OUTCOMES.index("conductors not measured")
ALIGNED, IN_PIECES, TOO_FEW, NOT_FOUND, _TOO_COARSE, _NOT_IN_VIEW = range(2, 8)
_NOT_NEAR = len(OUTCOMES) - 1


@dataclass(frozen=True, slots=True)
class SpanJudgement:
    """A row of the table span_judgements: metres of a span with one outcome for one rule."""

    span_id: str
    kind: str
    outcome: str
    length_m: float


@dataclass(frozen=True, slots=True, eq=False)
class SpanOutcomes:
    """Shares (B, len(OUTCOMES)) of the conductors of a span with each outcome, by kind of anomaly."""

    axis: SpanAxis
    by_kind: dict[str, Floats]


def judge_bins(
    axis: SpanAxis,
    is_judged: Mask,
    views: tuple[Mask, Mask],
    path_problems: tuple[Floats, Ints],
    rules: Rules,
) -> Ints:
    """Return the outcome of each bin (B,) as an index in OUTCOMES.

    Args:
        axis: the span.
        is_judged: bins (B,) with enough evidence.
        views: masks (N, B) of where a frame shows a bin, and where too coarsely.
        path_problems: positions (M, 2) of the camera, and the pose problem (M,) of each.
        rules: thresholds.
    """
    shown, coarse = views
    fine = shown & ~coarse
    outcome = _nearby_problems(axis, path_problems, rules)
    outcome[shown.any(axis=0)] = _TOO_COARSE
    outcome[fine.any(axis=0)] = NOT_FOUND
    outcome[is_judged] = JUDGED
    return outcome


def _nearby_problems(axis: SpanAxis, path_problems: tuple[Floats, Ints], rules: Rules) -> Ints:
    """Return the commonest problem (B,) of frames taken near each bin, as an index in OUTCOMES."""
    path, problems = path_problems
    near_m = rules.coverage["near_m"]
    centre = axis.centres[len(axis.centres) // 2, :2]
    near = np.hypot(*(path - centre).T) <= near_m + axis.length_m
    outcome = np.full(len(axis.centres), _NOT_NEAR)
    for i, point in enumerate(axis.centres[:, :2]):
        within = np.hypot(*(path[near] - point).T) <= near_m
        found = problems[near][within]
        if len(found):
            bad = found[found != NO_PROBLEM]
            is_bad = len(bad) > len(found) / 2
            outcome[i] = _NOT_IN_VIEW + 1 + np.bincount(bad).argmax() if is_bad else _NOT_IN_VIEW
    return outcome


def merge_outcomes(by_camera: Sequence[Sequence[SpanOutcomes]]) -> list[SpanJudgement]:
    """Return the metres of each outcome by span and rule. Over cameras, the best outcome of a bin counts."""
    axes = {one.axis.span_id: one.axis for outcomes in by_camera for one in outcomes}
    best: dict[tuple[str, str], Floats] = {}
    rank = np.arange(len(OUTCOMES))
    for one in (one for outcomes in by_camera for one in outcomes):
        for kind, shares in one.by_kind.items():
            key = one.axis.span_id, kind
            known = best.get(key, shares)
            is_better = (shares @ rank < known @ rank)[:, np.newaxis]
            best[key] = np.where(is_better, shares, known)
    return [
        SpanJudgement(span_id, kind, OUTCOMES[i], round(float(shares[:, i].sum() * axes[span_id].bin_m), 6))
        for (span_id, kind), shares in best.items()
        for i in np.flatnonzero(shares.any(axis=0)).tolist()
    ]
