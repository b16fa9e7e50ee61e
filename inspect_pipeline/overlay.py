"""Pictures of results: a frame of a flight with its lines drawn onto it."""

from __future__ import annotations

import json
import re
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from inspect_pipeline.errors import QueryError
from inspect_pipeline.images.draw import draw_lines, score_colours
from inspect_pipeline.index.query import run_query
from inspect_pipeline.recording.frames import iter_frames
from inspect_pipeline.store.images import open_images

if TYPE_CHECKING:
    from inspect_pipeline.arrays import ImageArray
    from inspect_pipeline.store.store import Store

_POLYLINES = {
    "lines": "list_transform(points, lambda p: [p.x, p.y])",
    "segments": "[[x1, y1], [x2, y2]]",
}
_FRAME = """
SELECT f.flight_id, f.frame_idx, f.log_time_ns, c.topic, m.score_threshold AS min_score,
       (SELECT list({{'points': {polyline}, 'score': score}})
        FROM {table} AS t
        WHERE t.flight_id = f.flight_id AND t.channel_id = f.channel_id AND t.frame_idx = f.frame_idx
       ) AS found
FROM frames AS f
JOIN channels AS c USING (flight_id, channel_id)
JOIN flights USING (flight_id)
JOIN models AS m USING (model_id)
WHERE starts_with(f.flight_id, '{flight}') AND f.status = 'ok' AND {where}
ORDER BY f.n_lines DESC, f.n_segments DESC, f.frame_idx
LIMIT 1
"""


@dataclass(frozen=True, slots=True)
class Overlay:
    """A frame with its lines drawn; image is uint8 (height, width, 3) RGB."""

    flight_id: str
    topic: str
    frame_idx: int
    n_drawn: int
    image: ImageArray


def draw_overlay(
    store: Store,
    flight: str,
    frame_idx: int | None = None,
    *,
    topic: str | None = None,
    segments: bool = False,
) -> Overlay:
    """Draw the lines of a frame of the flight whose id begins with `flight`.

    Args:
        store: the store that has the flight.
        flight: the first digits of a flight_id.
        frame_idx: the frame; by default the one with the most lines.
        topic: the camera topic; by default any.
        segments: draw the raw segments instead of the lines.

    Raises:
        QueryError: the index has no such frame.
        StoreError, RecordingError: the index, or the images of the flight, cannot be read.
    """
    row = _find_frame(store, flight, frame_idx, topic, "segments" if segments else "lines")
    found = row["found"] or []
    colours = score_colours(np.array([each["score"] for each in found], np.float32), row["min_score"])
    return Overlay(
        flight_id=row["flight_id"],
        topic=row["topic"],
        frame_idx=row["frame_idx"],
        n_drawn=len(found),
        image=draw_lines(
            _read_image(store, row), [np.array(each["points"], np.float32) for each in found], colours
        ),
    )


def _read_image(store: Store, row: dict[str, Any]) -> ImageArray:
    """Read the image of a row of `frames`: uint8 (height, width, 3) RGB."""
    record = store.load_flight(row["flight_id"])
    if record is None:
        raise QueryError(f"flight {row['flight_id'][:16]} is in the index but not in the store; rebuild it")
    source, time_ns = open_images(record, store.flight_dir(record.flight_id)), row["log_time_ns"]
    cameras = source.select_cameras([row["topic"]])
    frames = iter_frames(source, cameras, start_ns=time_ns, end_ns=time_ns + 1)
    image = next((frame.image for frame in frames if frame.frame_idx == row["frame_idx"]), None)
    if image is None:
        raise QueryError(f"frame {row['frame_idx']} is no longer in {source.path}; process it again")
    return image


def _find_frame(
    store: Store, flight: str, frame_idx: int | None, topic: str | None, table: str
) -> dict[str, Any]:
    """Return the row of the frame to draw."""
    if not re.fullmatch(r"[0-9a-f]{1,64}", flight):
        raise QueryError(f"{flight!r} is not the start of a flight_id; flights list shows them")
    conditions = [] if frame_idx is None else [f"f.frame_idx = {frame_idx}"]
    if topic is not None:
        conditions.append(f"c.topic = '{topic.replace(chr(39), chr(39) * 2)}'")
    sql = _FRAME.format(
        polyline=_POLYLINES[table], table=table, flight=flight, where=" AND ".join(conditions) or "true"
    )
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "frame.json"
        run_query(store.index_path, sql, format="json", output=output)
        rows: list[dict[str, Any]] = json.loads(output.read_text(encoding="utf-8"))
    if not rows:
        raise QueryError(f"flight {flight} has no decoded frame like that; see the table frames")
    return rows[0]
