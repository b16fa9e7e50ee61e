"""Compare two flights: what changed on the spans that both judged."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from inspect_pipeline.index.named_queries import find_query
from inspect_pipeline.index.reading import open_index

if TYPE_CHECKING:
    from inspect_pipeline.store.store import Store

_COMPARED = """
SELECT count(DISTINCT a.span_id) AS n
FROM span_states AS a
JOIN span_states AS b USING (span_id, subject)
WHERE a.flight_id = ? AND b.flight_id = ?
"""


@dataclass(frozen=True, slots=True)
class FlightComparison:
    """Changes between two flights, as of the named query `compare`, and how many spans both judged."""

    changes: list[dict[str, Any]]
    n_spans: int


def compare_flights(store: Store, before: str, after: str) -> FlightComparison:
    """Return what changed from one flight to another, by their ids; raises StoreError."""
    statement = find_query("compare").with_values({"before": before, "after": after})
    with open_index(store) as index:
        (compared,) = index.select(_COMPARED, [before, after])
        return FlightComparison(index.select(statement), compared["n"])
