"""Pictures of results: frames of a flight with their lines and anomalies drawn onto them.

frames = select_frames(store, flight_id, topic="/camera/image")
for drawn in draw_overlays(store, flight_id, frames):
    write_picture(Path(f"{drawn.frame_idx}.jpg"), drawn.image)
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import numpy as np

from inspect_pipeline.errors import QueryError, RecordingError
from inspect_pipeline.images.draw import add_strip, draw_lines, draw_place, draw_scores, track_colours
from inspect_pipeline.index.cameras import load_places
from inspect_pipeline.index.reading import select
from inspect_pipeline.inspection.places import PLACE_COLUMNS
from inspect_pipeline.store.images import iter_images, open_images

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from inspect_pipeline.arrays import ImageArray
    from inspect_pipeline.store.store import Store

    Row = dict[str, Any]

_FRAMES = f"""
SELECT f.channel_id, c.topic, f.frame_idx, f.log_time_ns, f.n_lines, f.n_segments,
       {", ".join(f"f.{name}" for name in PLACE_COLUMNS)}
FROM frames AS f
JOIN channels AS c USING (flight_id, channel_id)
WHERE f.flight_id = $flight_id AND f.status <> 'bad'
  AND ($topic IS NULL OR c.topic = $topic) AND ($frame_idx IS NULL OR f.frame_idx = $frame_idx)
ORDER BY f.log_time_ns, f.channel_id
"""  # noqa: S608 - names of columns
_ANOMALIES = "SELECT * FROM anomalies WHERE flight_id = ? ORDER BY start_ns, anomaly_id"
_FOUND = {
    "lines": "list_transform(points, lambda p: [p.x, p.y]) AS points, score, track_id",
    "segments": "[[x1, y1], [x2, y2]] AS points, score, NULL AS track_id",
}
_AT_A_TIME = 200  # frames whose lines are in memory
_RING_M = 2.5  # radius of the ring around a place


@dataclass(frozen=True, slots=True)
class Overlay:
    """A frame with its lines drawn; image is uint8 (height, width, 3) RGB, with a strip below the frame."""

    flight_id: str
    topic: str
    frame_idx: int
    log_time_ns: int
    n_drawn: int
    image: ImageArray


def select_frames(
    store: Store, flight_id: str, frame_idx: int | None = None, *, topic: str | None = None
) -> list[Row]:
    """Return the decoded frames of a flight in time order; raises QueryError when there is none."""
    values = {"flight_id": flight_id, "topic": topic, "frame_idx": frame_idx}
    if not (frames := select(store, _FRAMES, values)):
        raise QueryError(f"flight {flight_id[:16]} has no decoded frame like that; see the table frames")
    return frames


def draw_overlays(
    store: Store, flight_id: str, frames: Sequence[Row], *, segments: bool = False
) -> Iterator[Overlay]:
    """Yield the frames of `select_frames` with lines, scores and anomalies, and their time and place below.

    Raises StoreError, RecordingError.
    """
    stored = store.find_flight(flight_id)
    if stored is None:
        raise QueryError(f"flight {flight_id[:16]} is in the index but not in the store; rebuild it")
    recording = open_images(stored.record, stored.folder)
    anomalies = _Anomalies(store, flight_id)
    for start in range(0, len(frames), _AT_A_TIME):
        some = frames[start : start + _AT_A_TIME]
        rows = {(row["topic"], row["frame_idx"]): row for row in some}
        found = _load_lines(store, flight_id, some, "segments" if segments else "lines")
        times = {key: row["log_time_ns"] for key, row in rows.items()}
        n_drawn = 0
        for topic, frame_idx, image in iter_images(recording, times):
            row = rows[topic, frame_idx]
            lines = found.get((row["channel_id"], frame_idx), [])
            drawn = _draw(image, lines, anomalies.of(row), row, has_scores=not segments)
            yield Overlay(flight_id, topic, frame_idx, row["log_time_ns"], len(lines), drawn)
            n_drawn += 1
        if not n_drawn:
            problem = f"frame {some[0]['frame_idx']} of {some[0]['topic']} is no longer in it"
            raise RecordingError(recording.path, problem, "process it again")


def _load_lines(
    store: Store, flight_id: str, frames: Sequence[Row], table: str
) -> dict[tuple[int, int], list[Row]]:
    """Return the lines or segments of frames by channel_id and frame_idx."""
    sql = f"""
        SELECT channel_id, frame_idx, {_FOUND[table]} FROM {table}
        WHERE flight_id = $flight_id
          AND {{'channel_id': channel_id, 'frame_idx': frame_idx}} IN (SELECT unnest($keys))
    """  # noqa: S608 - names of tables and columns
    keys = [{"channel_id": row["channel_id"], "frame_idx": row["frame_idx"]} for row in frames]
    found: dict[tuple[int, int], list[Row]] = {}
    for row in select(store, sql, {"flight_id": flight_id, "keys": keys}):
        found.setdefault((row["channel_id"], row["frame_idx"]), []).append(row)
    return found


class _Anomalies:
    """The anomalies of a flight, and where they are in frames."""

    def __init__(self, store: Store, flight_id: str) -> None:
        self._rows = select(store, _ANOMALIES, [flight_id])
        self._see = load_places(store, flight_id)

    def of(self, frame: Row) -> list[tuple[str, float, float, float]]:
        """Return kind, x, y and metres per pixel of the anomalies that a frame shows; NaN without a place."""
        own = [
            row
            for row in self._rows
            if row["channel_id"] == frame["channel_id"]
            and row["first_frame_idx"] <= frame["frame_idx"] <= row["last_frame_idx"]
        ]
        places = [self._see(row, [frame])[0] for row in own]
        return [(row["kind"], *place.tolist()) for row, place in zip(own, places, strict=True)]


def _draw(
    image: ImageArray,
    lines: Sequence[Row],
    anomalies: Sequence[tuple[str, float, float, float]],
    frame: Row,
    *,
    has_scores: bool,
) -> ImageArray:
    points = [np.array(row["points"], np.float32) for row in lines]
    drawn = draw_lines(image, points, track_colours([row["track_id"] for row in lines]))
    if has_scores:
        drawn = draw_scores(drawn, points, np.array([row["score"] for row in lines], np.float32))
    for kind, x, y, gsd_m in anomalies:
        if np.isfinite(gsd_m):
            drawn = draw_place(drawn, np.array([x, y]), max(_RING_M / gsd_m, 12.0), kind)
    return add_strip(drawn, *_describe(frame, [kind for kind, *_ in anomalies]))


def _describe(frame: Row, kinds: Sequence[str]) -> tuple[str, str]:
    """Return the texts of the strip: time, place and anomalies; the frame."""
    time_ns = frame["log_time_ns"]
    time = datetime.fromtimestamp(time_ns // 10**9, UTC)
    parts = [f"{time:%Y-%m-%d %H:%M:%S}.{time_ns % 10**9 // 10**8} UTC"]
    if frame["lat_deg"] is not None and frame["lon_deg"] is not None:
        parts.append(f"{frame['lat_deg']:.6f}, {frame['lon_deg']:.6f}")
    if frame["height_m"] is not None:
        parts.append(f"{frame['height_m']:.0f} m above ground")
    return "   ".join([*parts, *dict.fromkeys(kinds)]), f"frame {frame['frame_idx']}"
