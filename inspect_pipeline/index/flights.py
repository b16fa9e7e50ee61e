"""Flights by name, and their rows in the index."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from inspect_pipeline.errors import AmbiguousIdError, UnknownIdError
from inspect_pipeline.index.reading import select
from inspect_pipeline.store.images import source_path

if TYPE_CHECKING:
    from collections.abc import Sequence

    from inspect_pipeline.store.store import Store

_DESCRIBE = """
SELECT s.* REPLACE (replace(s.start_utc::VARCHAR, ' ', 'T') || 'Z' AS start_utc,
                    replace(s.end_utc::VARCHAR, ' ', 'T') || 'Z' AS end_utc,
                    replace(s.ingested_at::VARCHAR, ' ', 'T') || 'Z' AS ingested_at),
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
_EVERY = "SELECT flight_id FROM flights ORDER BY start_ns, flight_id"
_SOURCES = "SELECT flight_id, source_uri FROM flights ORDER BY ingested_at DESC, flight_id"


def find_flight(store: Store, name: str) -> str:
    """Return the one flight that a name means; raises UnknownIdError, AmbiguousIdError, StoreError."""
    found = find_flights(store, name)
    if len(found) > 1:
        raise AmbiguousIdError("flight", name, len(found))
    return found[0]


def find_flights(store: Store, name: str | None) -> list[str]:
    """Return the flights that a name means, at least one; for None all, in the order of their times.

    A name is `last`, the file name of a recording, of which it is the one processed last, or the start of a
    flight_id. Raises UnknownIdError, StoreError.
    """
    if name is None:
        return [row["flight_id"] for row in select(store, _EVERY)]
    rows = select(store, _SOURCES) if name else []
    for row in rows:
        path = source_path(row["source_uri"])
        if name in ("last", path.name, path.stem, str(path)):
            return [row["flight_id"]]
    found = [row["flight_id"] for row in rows if row["flight_id"].startswith(name)]
    if not found:
        raise UnknownIdError("flight", name, "flights list")
    return found


def describe_flights(store: Store, flight_ids: Sequence[str]) -> list[dict[str, Any]]:
    """Return flights (all, if none is given) as in `flight_summary`, with their tags; raises StoreError."""
    return select(store, _DESCRIBE, [list(flight_ids), list(flight_ids)])
