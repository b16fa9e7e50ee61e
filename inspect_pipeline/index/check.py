"""Check flights: no open anomaly of the kinds that count, and enough coverage.

The kinds and the limits are in [check] of the rules. What could not be judged is reported as such.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from inspect_pipeline.index.inspected import Inspected, load_store_rules
from inspect_pipeline.index.publish import inspect_again
from inspect_pipeline.index.reading import open_index
from inspect_pipeline.inspection.rules import load_rules
from inspect_pipeline.store.feedback import load_reviews

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from inspect_pipeline.inspection.rules import Priority, Rules
    from inspect_pipeline.store.store import Store

_ANOMALIES = """
SELECT flight_id, anomaly_id, kind, reason FROM anomalies WHERE flight_id IN (SELECT unnest(?))
ORDER BY flight_id, start_ns, anomaly_id
"""
_COVERAGE = """
SELECT flight_id, kind, span_id, share, total, passed, reason FROM coverage
WHERE flight_id IN (SELECT unnest(?)) AND channel_id IS NULL AND kind IN ('frame', 'span')
ORDER BY flight_id, kind, span_id
"""
_JUDGEMENTS = """
SELECT flight_id, span_id, kind, outcome, length_m FROM span_judgements
WHERE flight_id IN (SELECT unnest(?)) ORDER BY ALL
"""


@dataclass(frozen=True, slots=True)
class FailedCheck:
    """A rule that a flight fails, or that could not judge it. anomaly_id is None for coverage."""

    flight_id: str
    rule: str
    detail: str
    anomaly_id: str | None
    outcome: Literal["failed", "not judged"] = "failed"


def check_flights(
    store: Store, flight_ids: Sequence[str], rules_path: Path | None, least_priority: Priority | None = None
) -> list[FailedCheck]:
    """Return the rules that flights of the index fail, then those that could not judge them.

    By the rules of the store, or by those of a file, for which everything is computed again and not kept.
    Where the rules say `fail_on_not_judged`, what was not judged has failed. With `least_priority` all kinds
    of this priority and higher count, in place of those of `fail_on`. Raises RulesError, StoreError.
    """
    if rules_path is None:
        rules = load_store_rules(store)
        found = _read(store, flight_ids)
    else:
        rules = load_rules(rules_path)
        found = inspect_again(store, flight_ids, rules)
    if least_priority is not None:
        rules = rules.failing_from(least_priority)
    dismissed = {one.anomaly_id for one in load_reviews(store) if one.verdict == "dismissed"}
    return [
        *_failed_anomalies(found.anomalies, dismissed, rules),
        *_failed_coverage(found.coverage, rules),
        *_not_judged(found, rules),
    ]


def rules_not_judged(store: Store, flight_ids: Sequence[str]) -> dict[str, list[str]]:
    """Return in words, by flight, which rules could not judge the spans it passed, and why.

    Flights whose spans were judged have no entry. Raises StoreError.
    """
    by_flight: dict[str, list[str]] = {}
    for one in _not_judged(_read(store, flight_ids), load_store_rules(store)):
        by_flight.setdefault(one.flight_id, []).append(f"{one.rule}: {one.detail}")
    return by_flight


def _read(store: Store, flight_ids: Sequence[str]) -> Inspected:
    with open_index(store) as index:
        return Inspected(
            *(index.select(sql, [list(flight_ids)]) for sql in (_ANOMALIES, _COVERAGE, _JUDGEMENTS))
        )


def _failed_anomalies(
    rows: Sequence[dict[str, Any]], dismissed: set[str], rules: Rules
) -> Iterator[FailedCheck]:
    for row in rows:
        if row["kind"] in rules.check["fail_on"] and row["anomaly_id"] not in dismissed:
            yield FailedCheck(row["flight_id"], row["kind"], row["reason"], row["anomaly_id"])


def _failed_coverage(rows: Sequence[dict[str, Any]], rules: Rules) -> Iterator[FailedCheck]:
    for row in rows:
        rule = f"min_{row['kind']}_share"
        is_checked = row["kind"] == "frame" or _is_passed(row)
        if is_checked and row["share"] is not None and row["share"] < rules.check.get(rule, 0.0):
            what = f"of span {row['span_id']} covered" if row["span_id"] else "of the frames are usable"
            detail = f"{100 * row['share']:.1f} % {what}, at least {100 * rules.check[rule]:.1f} % required"
            yield FailedCheck(row["flight_id"], rule, detail, None)


def _is_passed(row: Mapping[str, Any]) -> bool:
    """Return whether at least half of a span was passed within near_m of the path."""
    return row["kind"] == "span" and row["total"] is not None and row["passed"] >= row["total"] / 2


def _not_judged(found: Inspected, rules: Rules) -> Iterator[FailedCheck]:
    """Yield the rules of each flight, grouped by why they judged too little of the spans it passed."""
    outcome: Literal["failed", "not judged"] = "failed" if rules.check["fail_on_not_judged"] else "not judged"
    by_flight: dict[str, list[str]] = {}
    for row in found.coverage:
        by_flight.setdefault(row["flight_id"], [])
        if _is_passed(row):
            by_flight[row["flight_id"]].append(row["span_id"])
    kinds = [kind for kind in rules.check["fail_on"] if kind in {row["kind"] for row in found.judgements}]
    for flight_id, span_ids in by_flight.items():
        rules_by_detail: dict[str, list[str]] = {}
        for kind in kinds:
            own = [row for row in found.judgements if (row["flight_id"], row["kind"]) == (flight_id, kind)]
            reasons = [reason for span_id in span_ids if (reason := _why_not_judged(own, span_id, rules))]
            if reasons:
                commonest = max(dict.fromkeys(reasons), key=reasons.count)
                detail = f"not judged on {len(reasons)} of {len(span_ids)} spans: {commonest}"
                rules_by_detail.setdefault(detail, []).append(kind)
        for detail, names in rules_by_detail.items():
            yield FailedCheck(flight_id, ", ".join(names), detail, None, outcome)


def _why_not_judged(rows: Sequence[dict[str, Any]], span_id: str, rules: Rules) -> str | None:
    """Return the commonest reason why too little of a span was judged, None where enough was."""
    metres: dict[str, float] = {row["outcome"]: row["length_m"] for row in rows if row["span_id"] == span_id}
    judged_m = metres.pop("judged", 0.0)
    if judged_m >= rules.check["min_judged_share"] * (judged_m + sum(metres.values())):
        return None
    return max(metres, key=lambda outcome: metres[outcome])
