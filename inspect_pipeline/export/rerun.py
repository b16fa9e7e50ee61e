"""A flight as a recording of Rerun: images, lines by track, the path on a map, numbers and anomalies."""

from __future__ import annotations

import colorsys
from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image

from inspect_pipeline.atomic import appearing
from inspect_pipeline.errors import MissingExtraError, OutputError, UnknownIdError
from inspect_pipeline.export.rows import Redaction, Rows
from inspect_pipeline.index.reading import open_index
from inspect_pipeline.recording.frames import iter_frames
from inspect_pipeline.store.images import open_images

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from inspect_pipeline.recording.types import Frame
    from inspect_pipeline.store.store import Store

    Row = Mapping[str, Any]

_JPEG_QUALITY = 85
_TIMELINE = "time"
_NUMBERS = ("n_lines", "sharpness", "height_m", "gsd_m")
_LEVELS = {"open": "WARN", "confirmed": "ERROR", "dismissed": "INFO"}
_PATH_RGB, _SPAN_RGB, _ANOMALY_RGB, _GREY_RGB = (46, 158, 79), (28, 126, 214), (240, 140, 0), (134, 142, 150)
_GOLDEN = 0.618034  # of a turn of hue between tracks: neighbours differ most


def export_rrd(store: Store, flight_id: str, output: Path, redaction: Redaction | None = None) -> int:
    """Write a flight as .rrd and return the number of images in it.

    Raises MissingExtraError without rerun-sdk, RecordingError when the images are gone, UnknownIdError,
    OutputError, StoreError.
    """
    try:
        import rerun  # noqa: PLC0415 - an extra
    except ImportError as error:
        raise MissingExtraError("a recording of Rerun", "rerun") from error
    stored = store.find_flight(flight_id)
    if stored is None:
        raise UnknownIdError("flight of the store", flight_id[:16], "index verify")
    source = open_images(stored.record, stored.folder)
    try:
        with appearing(output) as path:
            stream = rerun.RecordingStream("lsnet-pipe", recording_id=flight_id)
            stream.set_log_time_enabled(enabled=False)
            stream.set_log_tick_enabled(enabled=False)
            stream.save(path)
            log = _Log(rerun, stream)
            with open_index(store) as index:
                tables = {
                    name: list(Rows(name, index.read_export(name, [flight_id]), redaction).dicts())
                    for name in ("frames", "lines", "spans", "anomalies", "signals")
                }
            log.write_tables(tables)
            n_images = sum(log.write_image(frame) for frame in iter_frames(source))
            stream.flush()
            stream.disconnect()
    except OSError as error:
        raise OutputError(output, f"cannot be written ({error.strerror})", "name another file") from error
    return n_images


class _Log:
    """Writes entities to a stream."""

    def __init__(self, rerun: Any, stream: Any) -> None:
        self._rr, self._stream = rerun, stream

    def write_tables(self, tables: Mapping[str, Sequence[Row]]) -> None:
        """Write all that is known without the images."""
        lines: dict[tuple[int, int], list[Row]] = {}
        for row in tables["lines"]:
            lines.setdefault((row["channel_id"], row["frame_idx"]), []).append(row)
        for row in tables["frames"]:
            self._at(row["log_time_ns"])
            self._write_frame(row, lines.get((row["channel_id"], row["frame_idx"]), []))
        for row in tables["signals"]:
            if row["value"] is not None:
                self._at(row["log_time_ns"])
                self._log(f"signals/{row['name']}", self._rr.Scalars(row["value"]))
        for row in tables["anomalies"]:
            self._at(row["start_ns"])
            text = f"{row['kind']}: {row['reason']} [{row['anomaly_id']}]"
            self._log("anomalies", self._rr.TextLog(text, level=_LEVELS[row["verdict"]]))
            if row["lat_deg"] is not None:
                self._log_place("map/anomalies", row, _ANOMALY_RGB)
        self._write_map(tables["frames"], tables["spans"])

    def write_image(self, frame: Frame) -> bool:
        """Write an image as JPEG; return whether the frame has one."""
        if frame.image is None:
            return False
        buffer = BytesIO()
        Image.fromarray(frame.image).save(buffer, "JPEG", quality=_JPEG_QUALITY)
        self._at(frame.log_time_ns)
        encoded = self._rr.EncodedImage(contents=buffer.getvalue(), media_type="image/jpeg")
        self._log(_camera(frame.topic), encoded)
        return True

    def _write_frame(self, row: Row, lines: Sequence[Row]) -> None:
        camera = _camera(row["topic"])
        strips = [[[point["x"], point["y"]] for point in line["points"]] for line in lines]
        colours = [track_colour(line["track_id"]) for line in lines]
        labels = [f"{line['score']:.2f}" for line in lines]
        shapes = self._rr.LineStrips2D(strips, colors=colours, labels=labels, show_labels=False)
        self._log(f"{camera}/lines", shapes)
        if row["lat_deg"] is not None:
            self._log_place("map/track", row, _PATH_RGB if row["n_lines"] else _GREY_RGB)
        for name in _NUMBERS:
            if row[name] is not None:
                self._log(f"numbers/{camera}/{name}", self._rr.Scalars(row[name]))

    def _write_map(self, frames: Sequence[Row], spans: Sequence[Row]) -> None:
        """Write what is on the map at all times: the path of each camera, and the spans."""
        paths: dict[int, list[list[float]]] = {}
        for row in frames:
            if row["lat_deg"] is not None:
                paths.setdefault(row["channel_id"], []).append([row["lat_deg"], row["lon_deg"]])
        ends = [
            [[row[f"{end}_lat_deg"], row[f"{end}_lon_deg"]] for end in ("from", "to")]
            for row in spans
            if row["from_lat_deg"] is not None
        ]
        for name, lines, colour in (("path", list(paths.values()), _PATH_RGB), ("spans", ends, _SPAN_RGB)):
            if lines:
                shape = self._rr.GeoLineStrings(lat_lon=lines, colors=colour, radii=-1.5)
                self._stream.log(f"map/{name}", shape, static=True)

    def _log_place(self, path: str, row: Row, colour: tuple[int, int, int]) -> None:
        place = [[row["lat_deg"], row["lon_deg"]]]
        self._log(path, self._rr.GeoPoints(lat_lon=place, colors=[colour], radii=[-6.0]))  # px of the screen

    def _at(self, time_ns: int) -> None:
        self._stream.set_time(_TIMELINE, timestamp=np.datetime64(time_ns, "ns"))

    def _log(self, path: str, entity: Any) -> None:
        self._stream.log(path, entity)


def _camera(topic: str) -> str:
    return topic.strip("/") or "camera"


def track_colour(track_id: int | None) -> tuple[int, int, int]:
    """Return a bright RGB colour for a track, grey for lines of none."""
    if track_id is None:
        return _GREY_RGB
    red, green, blue = colorsys.hsv_to_rgb(track_id * _GOLDEN % 1, 0.85, 1.0)
    return round(255 * red), round(255 * green), round(255 * blue)
