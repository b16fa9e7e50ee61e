"""Whether flights pass: no open anomaly of the kinds that count, and enough of them seen.

What counts and what is enough is in [check] of the rules.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from inspect_pipeline.index import publish as index
from inspect_pipeline.index.derived import load_store_rules
from inspect_pipeline.inspection.rules import load_rules
from inspect_pipeline.store.feedback import load_reviews

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from inspect_pipeline.inspection.rules import Rules
    from inspect_pipeline.store.store import Store

_ANOMALIES = """
SELECT flight_id, anomaly_id, kind, reason FROM anomalies WHERE flight_id IN (SELECT unnest(?))
ORDER BY flight_id, start_ns, anomaly_id
"""
_COVERAGE = """
SELECT flight_id, kind, span_id, share FROM coverage
WHERE flight_id IN (SELECT unnest(?)) AND channel_id IS NULL AND kind IN ('frame', 'span')
ORDER BY flight_id, kind, span_id
"""


@dataclass(frozen=True, slots=True)
class FailedCheck:
    """A rule that a flight fails; anomaly_id is None for coverage."""

    flight_id: str
    rule: str
    detail: str
    anomaly_id: str | None


def check_flights(store: Store, flight_ids: Sequence[str], rules_path: Path | None) -> list[FailedCheck]:
    """What flights of the index fail, by the rules of the store or those of a file.

    With a file everything is computed again, which the index does not keep. Raises RulesError, StoreError.
    """
    if rules_path is None:
        rules = load_store_rules(store)
        anomalies = index.select(store, _ANOMALIES, [list(flight_ids)])
        coverage = index.select(store, _COVERAGE, [list(flight_ids)])
    else:
        rules = load_rules(rules_path)
        anomalies, coverage = index.inspect_again(store, flight_ids, rules)
    dismissed = {one.anomaly_id for one in load_reviews(store) if one.verdict == "dismissed"}
    return [
        *_odd(anomalies, dismissed, rules),
        *_unseen(coverage, rules),
    ]


def _odd(rows: Sequence[dict[str, Any]], dismissed: set[str], rules: Rules) -> Iterator[FailedCheck]:
    for row in rows:
        if row["kind"] in rules.check["fail_on"] and row["anomaly_id"] not in dismissed:
            yield FailedCheck(row["flight_id"], row["kind"], row["reason"], row["anomaly_id"])


def _unseen(rows: Sequence[dict[str, Any]], rules: Rules) -> Iterator[FailedCheck]:
    for row in rows:
        rule = f"min_{row['kind']}_share"
        if row["share"] is not None and row["share"] < rules.check.get(rule, 0.0):
            what = f"of span {row['span_id']} seen" if row["span_id"] else "of the frames are usable"
            limit = f"{100 * rules.check[rule]:.1f} % is asked for"
            yield FailedCheck(row["flight_id"], rule, f"{100 * row['share']:.1f} % {what}, {limit}", None)
