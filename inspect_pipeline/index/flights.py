"""Flights by the start of their id, and their rows in the index."""

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
_LATEST = "SELECT flight_id FROM flights ORDER BY ingested_at DESC, flight_id LIMIT 1"
_SOURCES = "SELECT flight_id, source_uri FROM flights ORDER BY ingested_at DESC, flight_id"


def find_flight(store: Store, beginning: str) -> str:
    """Return the one flight_id that begins so; raises UnknownIdError, AmbiguousIdError, StoreError."""
    found = find_flights(store, beginning)
    if len(found) > 1:
        raise AmbiguousIdError("flight", beginning, len(found))
    return found[0]


def find_flights(store: Store, beginning: str) -> list[str]:
    """Return the flight_ids that begin so, at least one; raises UnknownIdError, StoreError."""
    rows = select(store, "SELECT flight_id FROM flights WHERE starts_with(flight_id, ?)", [beginning])
    if not rows or not beginning:
        raise UnknownIdError("flight", beginning, "flights list")
    return [row["flight_id"] for row in rows]


def describe_flights(store: Store, flight_ids: Sequence[str]) -> list[dict[str, Any]]:
    """Return flights (all, if none is given) as in `flight_summary`, with their tags; raises StoreError."""
    return select(store, _DESCRIBE, [list(flight_ids), list(flight_ids)])


def resolve_flight(store: Store, name: str) -> str:
    """Return the flight that a name means: `last`, the start of a flight_id, or the file name of a recording.

    Of several flights of recordings of one name it is the one processed last. Raises UnknownIdError,
    AmbiguousIdError, StoreError.
    """
    if name == "last":
        rows = select(store, _LATEST)
        if not rows:
            raise UnknownIdError("flight", name, "flights list")
        return str(rows[0]["flight_id"])
    for row in select(store, _SOURCES):
        path = source_path(row["source_uri"])
        if name in (path.name, path.stem, str(path)):
            return str(row["flight_id"])
    return find_flight(store, name)
