"""The page on which the lines of a frame are corrected, and the frame's picture."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Any

import cv2

from inspect_pipeline.errors import QueryError
from inspect_pipeline.images.draw import track_colours
from inspect_pipeline.index.reading import select
from inspect_pipeline.report.page import load_assets, render
from inspect_pipeline.store.feedback import add_correction, load_corrections
from inspect_pipeline.store.images import iter_images, open_images, source_path

if TYPE_CHECKING:
    from inspect_pipeline.report.page import Serving
    from inspect_pipeline.store.store import Store

_MAX_LINES, _MAX_POINTS = 500, 200
_QUALITY = 88
_FRAME = """
SELECT f.flight_id, f.channel_id, f.frame_idx, f.log_time_ns, f.width, f.height, c.topic, v.source_uri
FROM frames AS f
JOIN channels AS c USING (flight_id, channel_id)
JOIN flights AS v USING (flight_id)
WHERE starts_with(f.flight_id, ?) AND f.channel_id = ? AND f.frame_idx = ? AND f.width IS NOT NULL
"""
_LINES = """
SELECT track_id, score, list_transform(points, lambda p: [p.x, p.y]) AS points
FROM lines
WHERE flight_id = ? AND channel_id = ? AND frame_idx = ?
ORDER BY line_idx
"""


def find_frame(store: Store, flight: str, channel_id: int, frame_idx: int) -> dict[str, Any]:
    """Return the row of a decoded frame. Raises QueryError, StoreError."""
    rows = select(store, _FRAME, [flight, channel_id, frame_idx])
    if len(rows) != 1:
        raise QueryError(f"flight {flight} has no frame {frame_idx} of channel {channel_id}")
    return rows[0]


def render_frame(store: Store, frame: dict[str, Any], serving: Serving) -> str:
    """Return the page of a frame, with the lines as corrected, else as found. Raises StoreError."""
    key = (frame["flight_id"], frame["channel_id"], frame["frame_idx"])
    rows = select(store, _LINES, list(key))
    colours = track_colours([row["track_id"] for row in rows]).tolist()
    lines = [
        (row["points"], "#{:02x}{:02x}{:02x}".format(*colour))
        for row, colour in zip(rows, colours, strict=True)
    ]
    corrected = {(one.flight_id, one.channel_id, one.frame_idx): one for one in load_corrections(store)}
    if key in corrected:
        lines = [(points, "#ffffff") for points in corrected[key].lines]
    return render(
        "frame.html",
        assets=load_assets("frame.js", serving=serving),
        serving=serving,
        frame=frame,
        name=source_path(frame["source_uri"]).name,
        is_corrected=key in corrected,
        lines=[(" ".join(f"{x:.1f},{y:.1f}" for x, y in points), colour) for points, colour in lines],
    )


def encode_frame(store: Store, frame: dict[str, Any]) -> bytes:
    """Return the picture of a frame as JPEG in its full size. Raises RecordingError, QueryError."""
    stored = store.find_flight(frame["flight_id"])
    if stored is not None:
        wanted = {(frame["topic"], frame["frame_idx"]): frame["log_time_ns"]}
        for _, _, image in iter_images(open_images(stored.record, stored.folder), wanted):
            bgr = cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
            return cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1].tobytes()
    raise QueryError(f"frame {frame['frame_idx']} is no longer in the recording")


def save_lines(store: Store, frame: dict[str, Any], text: str, corrected_by: str) -> int:
    """Save the lines that a person says a frame has, as a JSON list of lists of [x, y], and return how many.

    Raises ValueError for anything else, StoreError.
    """
    try:
        lines = [_to_line(points, frame) for points in json.loads(text)]
    except (TypeError, RecursionError) as error:
        raise ValueError("not a list of lines") from error
    if len(lines) > _MAX_LINES:
        raise ValueError(f"more than {_MAX_LINES} lines")
    own = ("flight_id", "channel_id", "frame_idx", "log_time_ns", "width", "height")
    add_correction(store, {name: frame[name] for name in own}, lines, corrected_by)
    return len(lines)


def _to_line(points: Any, frame: dict[str, Any]) -> list[list[float]]:
    """Return the points of a line inside the frame. Raises TypeError, ValueError."""
    line = [[float(x), float(y)] for x, y in points]
    if not 2 <= len(line) <= _MAX_POINTS or not all(
        math.isfinite(value) for point in line for value in point
    ):
        raise ValueError("a line has two points or more")
    return [
        [round(min(max(x, 0.0), frame["width"]), 1), round(min(max(y, 0.0), frame["height"]), 1)]
        for x, y in line
    ]
