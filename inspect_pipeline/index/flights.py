"""Flights by name, and what the index says of them in a row."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from inspect_pipeline.errors import QueryError
from inspect_pipeline.index import publish as index

if TYPE_CHECKING:
    from collections.abc import Sequence

    from inspect_pipeline.store.store import Store

_DESCRIBE = """
SELECT s.* REPLACE (s.start_utc::VARCHAR AS start_utc, s.end_utc::VARCHAR AS end_utc,
                    s.ingested_at::VARCHAR AS ingested_at),
       coalesce(t.tags, map {}) AS tags
FROM flight_summary AS s
LEFT JOIN (
    SELECT flight_id, map_from_entries(list((key, value) ORDER BY key)) AS tags
    FROM flight_tags
    GROUP BY flight_id
) AS t USING (flight_id)
WHERE len(?) = 0 OR s.flight_id IN (SELECT unnest(?))
ORDER BY s.start_utc, s.flight_id
"""


def find_flight(store: Store, beginning: str) -> str:
    """The one flight_id with a beginning; raises QueryError, StoreError."""
    found = find_flights(store, beginning)
    if len(found) > 1:
        raise QueryError(f"{len(found)} flights begin with {beginning!r}; give more of it")
    return found[0]


def find_flights(store: Store, beginning: str) -> list[str]:
    """The flight_ids with a beginning, at least one; raises QueryError, StoreError."""
    if not re.fullmatch(r"[0-9a-f]{1,64}", beginning):
        raise QueryError(f"{beginning!r} is not the beginning of a flight_id; see lsnet-pipe flights list")
    rows = index.select(store, "SELECT flight_id FROM flights WHERE starts_with(flight_id, ?)", [beginning])
    if not rows:
        raise QueryError(f"no flight begins with {beginning!r}; see lsnet-pipe flights list")
    return [row["flight_id"] for row in rows]


def describe_flights(store: Store, flight_ids: Sequence[str]) -> list[dict[str, Any]]:
    """Flights, or all of them, as in flight_summary, and their tags; raises StoreError."""
    return index.select(store, _DESCRIBE, [list(flight_ids), list(flight_ids)])
