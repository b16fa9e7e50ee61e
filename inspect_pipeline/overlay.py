"""Pictures of what was found: the segments of the index drawn onto their frame."""

from __future__ import annotations

import json
import re
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from inspect_pipeline.atomic import appearing
from inspect_pipeline.errors import OutputError, QueryError
from inspect_pipeline.index.query import run_query
from inspect_pipeline.recording.frames import iter_frames
from inspect_pipeline.store.images import open_images

if TYPE_CHECKING:
    from inspect_pipeline.arrays import Floats32, ImageArray
    from inspect_pipeline.store.store import Store

_FRAME = """
SELECT f.flight_id, f.frame_idx, f.log_time_ns, c.topic,
       (SELECT list([x1, y1, x2, y2])
        FROM segments AS s
        WHERE s.flight_id = f.flight_id AND s.channel_id = f.channel_id AND s.frame_idx = f.frame_idx
       ) AS endpoints
FROM frames AS f
JOIN channels AS c USING (flight_id, channel_id)
WHERE starts_with(f.flight_id, '{flight}') AND f.status = 'ok' AND {which}
ORDER BY f.n_segments DESC, f.frame_idx
LIMIT 1
"""
_SHIFT = 4  # binary places of the coordinates given to OpenCV
_OUTLINE_BGR, _LINE_BGR = (30, 30, 30), (255, 230, 0)


@dataclass(frozen=True, slots=True)
class Overlay:
    """A drawn frame and where it is from; image is uint8 (height, width, 3) BGR."""

    flight_id: str
    topic: str
    frame_idx: int
    n_segments: int
    image: ImageArray


def draw_overlay(store: Store, flight: str, frame_idx: int | None = None) -> Overlay:
    """Draw a frame of the flight whose id begins with `flight`; else that with the most segments.

    Raises QueryError when the index has no such frame, StoreError, RecordingError.
    """
    row = _find_frame(store, flight, frame_idx)
    image = _read_image(store, row)
    endpoints = np.array(row["endpoints"] or [], np.float32).reshape(-1, 4)
    return Overlay(
        flight_id=row["flight_id"],
        topic=row["topic"],
        frame_idx=row["frame_idx"],
        n_segments=len(endpoints),
        image=draw_segments(image, endpoints),
    )


def draw_segments(image: ImageArray, endpoints: Floats32) -> ImageArray:
    """A BGR copy of an RGB image with (N, 4) segments in pixels."""
    canvas = cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    thickness = max(1, round(max(image.shape) / 900))
    # OpenCV counts from the centre of the top-left pixel.
    points = np.rint((endpoints - 0.5) * (1 << _SHIFT)).astype(int).reshape(-1, 2, 2)
    for colour, width in ((_OUTLINE_BGR, thickness + 2), (_LINE_BGR, thickness)):
        for first, last in points.tolist():
            cv2.line(canvas, first, last, colour, width, cv2.LINE_AA, _SHIFT)
    return canvas.astype(np.uint8, copy=False)


def write_picture(path: Path, image: ImageArray) -> None:
    """Write a BGR image, whole or not at all, as the type its name says. Raises OutputError."""
    try:
        is_known, data = cv2.imencode(path.suffix, image)
    except cv2.error:
        is_known = False
    if not is_known:
        raise OutputError(path, "no picture has such a name", "end it in .png or .jpg")
    try:
        with appearing(path) as part:
            part.write_bytes(data.tobytes())
    except OSError as error:
        raise OutputError(path, f"cannot be written ({error.strerror})", "name another file") from error


def _read_image(store: Store, row: dict[str, Any]) -> ImageArray:
    """The image of the row of a frame: uint8 (height, width, 3) RGB."""
    record = store.load_flight(row["flight_id"])
    if record is None:
        raise QueryError(f"flight {row['flight_id'][:16]} is not in the store; lsnet-pipe index rebuild")
    source, time_ns = open_images(record, store.flight_dir(record.flight_id)), row["log_time_ns"]
    cameras = source.select_cameras([row["topic"]])
    frames = iter_frames(source, cameras, start_ns=time_ns, end_ns=time_ns + 1)
    image = next((frame.image for frame in frames if frame.frame_idx == row["frame_idx"]), None)
    if image is None:
        raise QueryError(f"frame {row['frame_idx']} is not in {source.path} any more; process it again")
    return image


def _find_frame(store: Store, flight: str, frame_idx: int | None) -> dict[str, Any]:
    """The row of the frame to draw."""
    if not re.fullmatch(r"[0-9a-f]{1,64}", flight):
        raise QueryError(f"{flight!r} is not the beginning of a flight_id; lsnet-pipe query lists them")
    which = "true" if frame_idx is None else f"f.frame_idx = {frame_idx}"
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "frame.json"
        run_query(store.index_path, _FRAME.format(flight=flight, which=which), format="json", output=output)
        rows: list[dict[str, Any]] = json.loads(output.read_text(encoding="utf-8"))
    if not rows:
        raise QueryError(f"no decoded frame like that in flight {flight}; see the table frames")
    return rows[0]
