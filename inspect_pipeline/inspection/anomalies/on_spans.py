"""All rules about the conductors of spans, and which bins each of them judged."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from inspect_pipeline.inspection.anomalies.conductors import (
    compared_share,
    find_converging,
    measure_conductors,
)
from inspect_pipeline.inspection.anomalies.crossings import find_crossings_of_span
from inspect_pipeline.inspection.anomalies.hidden import hides_none
from inspect_pipeline.inspection.anomalies.sags import find_sag_changes, measured_fits
from inspect_pipeline.inspection.anomalies.spans import (
    count_places,
    doubt_rare,
    find_count_changes,
    inner_bins,
    missing_conductors,
    usual_count,
)
from inspect_pipeline.inspection.conductors.rows import conductor_rows
from inspect_pipeline.inspection.judgement import (
    ALIGNED,
    IN_PIECES,
    JUDGED,
    NOT_MEASURED,
    OUTCOMES,
    TOO_FEW,
    SpanOutcomes,
)
from inspect_pipeline.inspection.span_evidence import PRESENT, UNKNOWN, share_missed

if TYPE_CHECKING:
    from collections.abc import Sequence

    from inspect_pipeline.arrays import Floats
    from inspect_pipeline.geometry.local_frame import LocalMetres
    from inspect_pipeline.inspection.anomalies.conductors import SpanConductor
    from inspect_pipeline.inspection.anomalies.frames import Finding
    from inspect_pipeline.inspection.conductors.rows import ConductorRow
    from inspect_pipeline.inspection.rules import Rules
    from inspect_pipeline.inspection.span_evidence import SpanEvidence

_MIN_EXPLAINED = 0.9  # of what lines show, where errors of poses could explain the rest
_ABOUT_ABSENCE = ("conductor_count", "conductor_lost", "conductor_gap")
_HIDDEN_SHARE = 0.5  # of the views of a bin, from which on its conductor is hidden by another


@dataclass(frozen=True, slots=True)
class ConductorFindings:
    """Findings of one camera on spans, the outcomes of the rules on each span, and its conductors."""

    findings: list[Finding]
    outcomes: list[SpanOutcomes]
    conductors: list[ConductorRow]


def find_on_spans(
    channel_id: int, evidence: Sequence[SpanEvidence], origin: LocalMetres, rules: Rules
) -> ConductorFindings:
    """Apply all rules about conductors to the spans near the path of a camera."""
    evidence = doubt_rare(evidence, rules)
    is_whole = share_missed(evidence) <= rules.anomalies["max_missed_share"]
    if not is_whole:
        evidence = [replace(one, states=np.where(one.is_present, PRESENT, UNKNOWN)) for one in evidence]
    usual = usual_count(evidence, rules)
    findings: list[Finding] = []
    outcomes: list[SpanOutcomes] = []
    rows: list[ConductorRow] = []
    for one in evidence:
        expected = one.axis.expected_conductors or usual
        conductors = measure_conductors(one, rules)
        # One that sags may also appear closer to a neighbour, and missing where it was: report it once.
        moved = list(find_sag_changes(one, conductors, origin, rules))
        if not moved and _are_all_placed(one, expected):
            moved = list(find_converging(one, conductors, origin, rules))
        known = {number for finding in moved for number in finding.conductors}
        findings += moved
        findings += find_crossings_of_span(one, evidence, origin, rules)
        found = list(find_count_changes(one, expected, origin, rules)) if expected and is_whole else []
        findings += [each for each in found if not known.intersection(each.conductors)]
        outcome = _outcomes(one, expected, conductors, found, rules)
        outcomes.append(outcome if is_whole else _doubt_absence(outcome))
        fits = {each.number: each.fit for each in conductors}
        rows += conductor_rows(channel_id, one, [fits.get(k) for k in range(len(one.places))])
    return ConductorFindings(findings, outcomes, rows)


def _are_all_placed(one: SpanEvidence, expected: int) -> bool:
    """Return whether all conductors have places: with errors of poses, lines of others mix with theirs."""
    return one.sight.is_exact or (one.explained >= _MIN_EXPLAINED and len(one.places) == expected)


def _outcomes(
    one: SpanEvidence,
    expected: int,
    conductors: Sequence[SpanConductor],
    found: Sequence[Finding],
    rules: Rules,
) -> SpanOutcomes:
    """Return the outcome of each bin by each rule. Bins next to structures have that of the nearest other.

    found: findings about the number of conductors.
    """
    shares = _count_outcomes(one, expected)
    inner = np.flatnonzero(inner_bins(one, rules))
    if len(inner):
        shares = shares[np.clip(np.arange(len(shares)), inner[0], inner[-1])]
    counted = shares
    if len(one.places) < expected and not len(missing_conductors(one, rules)) and not hides_none(one, rules):
        # One that no span shows: missing everywhere, or always behind another.
        counted = _move(shares, JUDGED, ALIGNED)
    if count_places(one, expected) > expected and not found:
        # One place is that of no conductor: what is missing there may be nothing.
        shares = counted = _move(shares, JUDGED, ALIGNED)
    compared = compared_share(one, conductors, rules) * _are_all_placed(one, expected)
    has_sag = np.full(
        len(shares), len(measured_fits(one, conductors, rules)) / max(len(one.places), expected, 1)
    )
    return SpanOutcomes(
        one.axis,
        {
            "conductor_count": counted,
            "conductor_lost": shares,
            "conductor_gap": shares,
            "sag_change": _measured(shares, has_sag),
            "conductors_converging": _measured(shares, compared),
        },
    )


def _doubt_absence(outcomes: SpanOutcomes) -> SpanOutcomes:
    """Return the outcomes where lines are in pieces: that a part has none says nothing of the conductor."""
    by_kind = {
        kind: _move(shares, JUDGED, IN_PIECES) if kind in _ABOUT_ABSENCE else shares
        for kind, shares in outcomes.by_kind.items()
    }
    return replace(outcomes, by_kind=by_kind)


def _count_outcomes(one: SpanEvidence, expected: int) -> Floats:
    """Return shares (B, len(OUTCOMES)) of the expected conductors by how they could be judged."""
    n_bins, n_places = len(one.outcome), len(one.places)
    shares = np.zeros((n_bins, len(OUTCOMES)))
    shares[np.arange(n_bins), one.outcome] = 1.0
    if one.votes is None:
        return shares
    is_known = one.is_judged
    is_hidden = ~is_known & (one.votes.hidden >= _HIDDEN_SHARE)
    n_all = max(expected, n_places)
    in_view = one.sight.fine.any(axis=0)
    shares[in_view] = 0.0
    shares[in_view, JUDGED] = is_known.sum(axis=0)[in_view] / n_all
    shares[in_view, ALIGNED] = (is_hidden.sum(axis=0)[in_view] + n_all - n_places) / n_all
    shares[in_view, TOO_FEW] = (~is_known & ~is_hidden).sum(axis=0)[in_view] / n_all
    return shares


def _measured(shares: Floats, measured: Floats) -> Floats:
    """Return the shares of a rule that measures conductors, those `measured` (B,) as judged."""
    judged = np.clip(measured, 0, 1)[:, np.newaxis]
    rest = _move(shares, JUDGED, NOT_MEASURED) * (1 - judged)
    rest[:, JUDGED] = judged[:, 0]
    return rest


def _move(shares: Floats, source: int, target: int) -> Floats:
    moved = shares.copy()
    moved[:, target] += moved[:, source]
    moved[:, source] = 0.0
    return moved
