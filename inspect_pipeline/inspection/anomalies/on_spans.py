"""All rules about the conductors of spans, and which bins each of them judged."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from inspect_pipeline.inspection.anomalies.conductors import (
    MIN_SAGS,
    compared_bins,
    conductor_tracks,
    find_converging,
    find_sag_changes,
    measured_sag,
)
from inspect_pipeline.inspection.anomalies.spans import find_count_changes, inner_bins, usual_count
from inspect_pipeline.inspection.judgement import JUDGED, NOT_MEASURED, SpanOutcomes

if TYPE_CHECKING:
    from collections.abc import Sequence

    from inspect_pipeline.arrays import Mask
    from inspect_pipeline.geometry.local_frame import LocalMetres
    from inspect_pipeline.inspection.anomalies.conductors import ConductorTrack
    from inspect_pipeline.inspection.anomalies.frames import Finding
    from inspect_pipeline.inspection.rules import Rules
    from inspect_pipeline.inspection.span_evidence import SpanEvidence

COUNT_KINDS = ("conductor_count", "conductor_lost", "conductor_gap")


@dataclass(frozen=True, slots=True)
class ConductorFindings:
    """Findings of one camera on spans, and the outcomes of the rules on each span."""

    findings: list[Finding]
    outcomes: list[SpanOutcomes]


def find_on_spans(evidence: Sequence[SpanEvidence], origin: LocalMetres, rules: Rules) -> ConductorFindings:
    """Apply all rules about conductors to the spans near the path of a camera."""
    usual = usual_count([one.level for one in evidence])
    findings: list[Finding] = []
    outcomes: list[SpanOutcomes] = []
    for one in evidence:
        expected = one.axis.expected_conductors or usual
        conductors = conductor_tracks(one, rules)
        if expected:
            findings += find_count_changes(one, expected, origin, rules)
        # A conductor that sags may also appear closer to a neighbour: report it once.
        sagging = list(find_sag_changes(one, conductors, origin, rules))
        findings += sagging or find_converging(one, conductors, origin, rules)
        outcomes.append(_outcomes(one, conductors, rules))
    return ConductorFindings(findings, outcomes)


def _outcomes(one: SpanEvidence, conductors: Sequence[ConductorTrack], rules: Rules) -> SpanOutcomes:
    """Return the outcome of each bin by each rule. Bins next to structures have that of the nearest other."""
    inner = np.flatnonzero(inner_bins(one, rules))
    if len(inner):
        nearest = np.clip(np.arange(len(one.outcome)), inner[0], inner[-1])
        counted = one.outcome[nearest]
    else:
        counted = one.outcome

    def measured(mask: Mask) -> np.ndarray:
        return np.where(mask, JUDGED, np.where(counted == JUDGED, NOT_MEASURED, counted))

    has_sag = np.full(len(counted), len(measured_sag(conductors)) >= MIN_SAGS)
    return SpanOutcomes(
        one.axis,
        dict.fromkeys(COUNT_KINDS, counted)
        | {
            "sag_change": measured(has_sag),
            "conductors_converging": measured(compared_bins(one, conductors, rules)),
        },
    )
