"""Anomalies of the index with their reviews."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from inspect_pipeline.errors import AmbiguousIdError, UnknownIdError
from inspect_pipeline.index.reading import select

if TYPE_CHECKING:
    from collections.abc import Sequence

    from inspect_pipeline.store.store import Store

_LIST = """
SELECT * EXCLUDE (start_utc, end_utc, reviewed_at),
       replace(start_utc::VARCHAR, ' ', 'T') || 'Z' AS start_utc,
       replace(end_utc::VARCHAR, ' ', 'T') || 'Z' AS end_utc,
       replace(reviewed_at::VARCHAR, ' ', 'T') || 'Z' AS reviewed_at
FROM reviewed_anomalies
WHERE len(?) = 0 OR flight_id IN (SELECT unnest(?))
ORDER BY start_ns, anomaly_id
"""


def list_anomalies(store: Store, flight_ids: Sequence[str]) -> list[dict[str, Any]]:
    """Return the anomalies of flights (of all, if none is given) by time, as in `reviewed_anomalies`.

    Raises StoreError.
    """
    return select(store, _LIST, [list(flight_ids), list(flight_ids)])


def find_anomaly(store: Store, beginning: str) -> dict[str, Any]:
    """Return the row of the one anomaly whose id begins so.

    Raises UnknownIdError, AmbiguousIdError, StoreError.
    """
    rows = select(store, "SELECT * FROM anomalies WHERE starts_with(anomaly_id, ?)", [beginning])
    if not rows or not beginning:
        raise UnknownIdError("anomaly", beginning, "anomalies list --all")
    if len(rows) > 1:
        raise AmbiguousIdError("anomaly", beginning, len(rows))
    return rows[0]
