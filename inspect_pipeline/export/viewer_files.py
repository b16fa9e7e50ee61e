"""The files in a flight's folder with which viewers open ready: review.mcap and layout.json."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from inspect_pipeline.atomic import write_whole
from inspect_pipeline.export.layout import make_layout
from inspect_pipeline.export.review import write_review

if TYPE_CHECKING:
    from inspect_pipeline.index.reading import IndexReader
    from inspect_pipeline.store.store import Store

REVIEW, LAYOUT = "review.mcap", "layout.json"
_CONTENT = """
SELECT (SELECT list(topic ORDER BY channel_id) FROM channels WHERE flight_id = $flight_id) AS topics,
       (SELECT list(DISTINCT name ORDER BY name) FROM signals WHERE flight_id = $flight_id) AS signals,
       (SELECT [lat_deg, lon_deg] FROM frames WHERE flight_id = $flight_id AND lat_deg IS NOT NULL
        ORDER BY log_time_ns, channel_id LIMIT 1) AS centre
"""


def write_viewer_files(index: IndexReader, store: Store, flight_id: str) -> None:
    """Write review.mcap and layout.json of a flight, replacing older ones. Raises OSError."""
    folder = store.flight_dir(flight_id)
    write_review(index, flight_id, folder / REVIEW)
    (found,) = index.select(_CONTENT, {"flight_id": flight_id})
    layout = make_layout(
        found["topics"] or [], found["signals"] or [], found["centre"] and tuple(found["centre"])
    )
    write_whole(folder / LAYOUT, json.dumps(layout, indent=1) + "\n")
