"""review.mcap: what the index says of a flight, on channels that viewers draw beside its recording.

`<image topic>/lsnet/track`     foxglove.GeoJSON: the path, coloured by coverage; a click seeks to its time
`<image topic>/lsnet/numbers`   JSON: numbers of each frame, for plots
/lsnet/review/spans             foxglove.GeoJSON: the spans, coloured by how much of them was covered
/lsnet/review/anomalies         foxglove.GeoJSON: a ring around each anomaly that has a place
/lsnet/review/log               foxglove.Log: a line for each anomaly
"""

from __future__ import annotations

import heapq
import html
import json
from itertools import count
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from inspect_pipeline.export.layout import (
    ANOMALIES_TOPIC,
    LOG_TOPIC,
    NUMBERS_SUFFIX,
    SPANS_TOPIC,
    TRACK_SUFFIX,
)
from inspect_pipeline.geometry.local_frame import LocalMetres
from inspect_pipeline.recording.writer import MessageSchema, new_recording
from inspect_pipeline.resources import read_schema

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping
    from pathlib import Path

    from inspect_pipeline.index.reading import IndexReader
    from inspect_pipeline.recording.writer import LogLevel, RecordingAuthor

    Row = Mapping[str, Any]

GREEN, ORANGE, RED, GREY, BLUE = "#2e9e4f", "#f08c00", "#e03131", "#868e96", "#1c7ed6"
_STATES = {"lines": GREEN, "no lines": ORANGE, "unusable": GREY}  # of a frame on the track
_VERDICTS: dict[str, tuple[str, LogLevel]] = {
    "open": (ORANGE, "WARNING"),
    "confirmed": (RED, "ERROR"),
    "dismissed": (GREY, "INFO"),
}
_MAX_PIECES = 1000  # of a track: viewers draw each by itself
_RING_M, _RING_POINTS = 3.0, 13  # radius and corners of the mark of an anomaly
_WHOLE = 0.95  # share of a span from which on it is shown as covered
_NOT_NUMBERS = ("channel_id", "log_time_ns", "status", "lat_deg", "lon_deg", "signals")
_FLIGHT = """
SELECT coalesce(start_ns, 0) AS start_ns, n_frames,
       (SELECT list({'channel_id': channel_id, 'topic': topic} ORDER BY channel_id)
        FROM channels WHERE flight_id = f.flight_id) AS channels
FROM flights AS f
WHERE flight_id = ?
"""


class _Event(NamedTuple):
    """A message to write: a feature of a map, numbers, or the anomaly of a log line."""

    time_ns: int
    topic: str
    content: Any


def write_review(index: IndexReader, flight_id: str, target: Path) -> None:
    """Write review.mcap, replacing an older one; the same index gives the same bytes.

    Raises OSError, and the errors of the index.
    """
    (flight,) = index.select(_FLIGHT, [flight_id])
    anomalies = list(index.iter_rows("anomalies", flight_id))
    max_frames = max(1, flight["n_frames"] // _MAX_PIECES)
    topics = {channel["channel_id"]: channel["topic"] for channel in flight["channels"] or ()}
    streams = [
        _span_events(index.iter_rows("spans", flight_id), flight["start_ns"]),
        [_Event(row["start_ns"], LOG_TOPIC, row) for row in anomalies],
        [
            _Event(row["start_ns"], ANOMALIES_TOPIC, _anomaly_feature(row))
            for row in anomalies
            if _is_placed(row)
        ],
        _camera_events(index.iter_rows("numbers", flight_id), topics, max_frames),
    ]
    schema = read_schema("frame_numbers.json").encode()
    numbers = MessageSchema("lsnet.FrameNumbers", "jsonschema", schema, "json")
    with new_recording(target, replace=True) as author:
        for event in heapq.merge(*streams, key=lambda event: event.time_ns):
            _write(author, event, numbers)


def _write(author: RecordingAuthor, event: _Event, numbers: MessageSchema) -> None:
    if event.topic == LOG_TOPIC:
        row = event.content
        where = f" (span {row['span_id']})" if row["span_id"] else ""
        text = f"{row['verdict']}: {row['reason']}{where} [{row['anomaly_id']}]"
        author.write_log(event.topic, event.time_ns, _VERDICTS[row["verdict"]][1], row["kind"], text)
    elif event.topic.endswith(NUMBERS_SUFFIX):
        author.write_encoded(event.topic, event.time_ns, numbers, json.dumps(event.content).encode())
    else:
        author.write_geojson(event.topic, event.time_ns, json.dumps(event.content))


def _is_placed(row: Row) -> bool:
    return row["lat_deg"] is not None and row["lon_deg"] is not None


def _camera_events(rows: Iterable[Row], topics: Mapping[int, str], max_frames: int) -> Iterator[_Event]:
    """Yield the pieces of each camera's track, of at most `max_frames` frames, before their numbers.

    Frames and events are in the order of time; an event waits for the pieces that began before it.
    """
    pieces: dict[int, list[Row]] = {}
    waiting: list[tuple[int, int, _Event]] = []
    n_events = count()

    def add(piece: list[Row], following: list[Row]) -> None:
        for event in _piece_events(piece, following, topics[piece[0]["channel_id"]]):
            heapq.heappush(waiting, (event.time_ns, next(n_events), event))

    for row in rows:
        piece = pieces.setdefault(row["channel_id"], [])
        if piece and (len(piece) >= max_frames or _state(row) != _state(piece[-1])):
            add(piece, [row])
            pieces[row["channel_id"]] = piece = [row]
            begin_ns = min(each[0]["log_time_ns"] for each in pieces.values())
            while waiting and waiting[0][0] < begin_ns:
                yield heapq.heappop(waiting)[2]
        else:
            piece.append(row)
    for piece in pieces.values():
        add(piece, [])
    yield from (heapq.heappop(waiting)[2] for _ in range(len(waiting)))


def _piece_events(piece: list[Row], following: list[Row], topic: str) -> Iterator[_Event]:
    """Yield the track from the first frame of a piece to the one that follows it, and its numbers."""
    places = [[row["lon_deg"], row["lat_deg"]] for row in (*piece, *following) if _is_placed(row)]
    if len(places) > 1:
        state, first, last = _state(piece[0]), piece[0]["frame_idx"], piece[-1]["frame_idx"]
        frames = f"frame {first}" if first == last else f"frames {first} to {last}"
        shape = {"type": "LineString", "coordinates": places}
        yield _Event(
            piece[0]["log_time_ns"],
            f"{topic}{TRACK_SUFFIX}",
            to_feature(shape, f"{frames}: {state}", _STATES[state]),
        )
    for row in piece:
        numbers = {
            name: value for name, value in row.items() if value is not None and name not in _NOT_NUMBERS
        }
        if row["signals"]:
            numbers["signals"] = {one["name"]: one["value"] for one in row["signals"]}
        yield _Event(row["log_time_ns"], f"{topic}{NUMBERS_SUFFIX}", numbers)


def _state(row: Row) -> str:
    if row["status"] != "ok":
        return "unusable"
    return "lines" if row["n_lines"] else "no lines"


def _span_events(rows: Iterable[Row], start_ns: int) -> list[_Event]:
    """Return the spans, each at the time it was first seen, else at the start of the flight."""
    events = []
    for row in rows:
        ends = [[row[f"{end}_lon_deg"], row[f"{end}_lat_deg"]] for end in ("from", "to")]
        text, colour = _describe_span(row)
        shape = {"type": "LineString", "coordinates": ends}
        time_ns = row["first_ns"] if row["first_ns"] is not None else start_ns
        events.append(
            _Event(time_ns, SPANS_TOPIC, to_feature(shape, f"span {row['span_id']}: {text}", colour))
        )
    return sorted(events, key=lambda event: event.time_ns)


def _describe_span(row: Row) -> tuple[str, str]:
    """Return how much of a span was covered, in words and as a colour."""
    if row["flight_id"] is None:
        return "not near this flight", GREY
    if row["share"] is None:
        return row["reason"] or "unknown", GREY
    colour = GREEN if row["share"] >= _WHOLE else BLUE if row["share"] > 0 else RED
    return f"{row['share']:.0%} covered", colour


def _anomaly_feature(row: Row) -> dict[str, Any]:
    shape = {"type": "Polygon", "coordinates": [_ring(row["lat_deg"], row["lon_deg"])]}
    return to_feature(
        shape, f"{row['kind']} ({row['verdict']}): {row['reason']}", _VERDICTS[row["verdict"]][0]
    )


def to_feature(geometry: dict[str, Any], name: str, colour: str) -> dict[str, Any]:
    """Return a feature with the properties by which viewers label and draw it; they take labels for HTML."""
    style = {"color": colour, "weight": 4, "opacity": 0.9}
    properties = {"name": html.escape(name, quote=False), "style": style}
    return {"type": "Feature", "geometry": geometry, "properties": properties}


def _ring(lat_deg: float, lon_deg: float) -> list[list[float]]:
    """Return a circle around a place, since viewers draw points as markers of one colour."""
    turns = np.linspace(0, 2 * np.pi, _RING_POINTS)
    around_m = _RING_M * np.column_stack((np.sin(turns), np.cos(turns)))
    lats_deg, lons_deg = LocalMetres(lat_deg, lon_deg).to_degrees(around_m)
    return np.column_stack((lons_deg, lats_deg)).tolist()  # type: ignore[no-any-return]
