"""The writer of the rows of one flight, frame by frame.

The rows become frames, segments, lines, tracks and signals.parquet. They wait in NumPy columns,
then in an in-memory DuckDB that spills into the flight's folder, so memory stays bounded however many
segments a flight has.
"""

from __future__ import annotations

from functools import cache
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Self

import duckdb
import numpy as np

from inspect_pipeline.errors import StoreError
from inspect_pipeline.georeference.frame_pose import FramePose
from inspect_pipeline.index.columns import (
    NULLABLE_FLOATS,
    FoundLines,
    FoundSegments,
    FoundSignals,
    frame_columns,
    line_columns,
    segment_columns,
    signal_columns,
    track_columns,
)
from inspect_pipeline.index.schema import create_tables
from inspect_pipeline.store.records import FlightTotals

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path
    from types import TracebackType

    from inspect_pipeline.arrays import Floats32, Ints32
    from inspect_pipeline.index.columns import Columns
    from inspect_pipeline.recording.types import Frame
    from inspect_pipeline.tracking.tracker import TrackRow
    from lsnet.segments import Detections

ROW_TABLES = ("frames", "segments", "lines", "tracks", "signals")

_FLUSH_ROWS = 65_536
_NOWHERE = FramePose()
_NO_SIGNALS: Mapping[str, float | None] = MappingProxyType({})
_CONFIG: dict[str, str | bool | int | float | list[str]] = {
    "memory_limit": "96MB",
    "threads": "1",
    "python_enable_replacements": "false",
}

_INSERT_FRAMES = f"""
INSERT INTO frames BY NAME
SELECT $flight_id AS flight_id,
       * REPLACE (nullif(width, 0) AS width, nullif(height, 0) AS height,
                  {", ".join(f"if(isnan({name}), NULL, {name}) AS {name}" for name in NULLABLE_FLOATS)}),
       CASE WHEN reason IS NULL THEN 'ok' WHEN width > 0 THEN 'doubtful' ELSE 'bad' END AS status
FROM frame_rows
"""
_INSERT_SEGMENTS = """
INSERT INTO segments BY NAME
SELECT $flight_id AS flight_id, * REPLACE (if(line_idx < 0, NULL, line_idx) AS line_idx) FROM segment_rows
"""
_INSERT_LINES = """
INSERT INTO lines BY NAME
SELECT $flight_id AS flight_id,
       l.* EXCLUDE (row_idx) REPLACE (if(isnan(track_score), NULL, track_score) AS track_score), p.points
FROM line_rows AS l
JOIN (
    SELECT row_idx, list(struct_pack(x := x, y := y) ORDER BY point_idx) AS points
    FROM point_rows
    GROUP BY row_idx
) AS p USING (row_idx)
ORDER BY row_idx
"""

_COPY = """
COPY (SELECT COLUMNS(lambda name: NOT ends_with(name, '_utc')) FROM {table})
TO $path (FORMAT parquet, COMPRESSION zstd)
"""
_TOTALS = """
SELECT count(*), count(*) FILTER (status = 'bad'), coalesce(sum(n_segments), 0)::BIGINT,
       coalesce(sum(n_lines), 0)::BIGINT, min(log_time_ns), max(log_time_ns)
FROM frames
"""
_INSERT_TRACKS = "INSERT INTO tracks BY NAME SELECT $flight_id AS flight_id, * FROM track_rows"
_INSERT_SIGNALS = """
INSERT INTO signals BY NAME
SELECT $flight_id AS flight_id, * REPLACE (if(isnan(value), NULL, value) AS value) FROM signal_rows
"""
_DROP_LINES_OF_OTHER_TRACKS = """
UPDATE lines SET track_id = NULL
WHERE (channel_id, track_id) NOT IN (SELECT (channel_id, track_id) FROM tracks)
"""


@cache  # running the migrations takes longer than everything else about a short flight
def _row_tables() -> tuple[str, ...]:
    """Return the statements that create the row tables as the migrations leave them."""
    with duckdb.connect(":memory:", config=_CONFIG) as connection:
        create_tables(connection)
        statement = "SELECT sql FROM duckdb_tables() WHERE table_name IN (SELECT unnest(?))"
        return tuple(sql for (sql,) in connection.execute(statement, [list(ROW_TABLES)]).fetchall())


class FlightWriter:
    """Writes the rows of a flight into `folder`; `finish` makes the files.

    Raises StoreError when the folder cannot be written.
    """

    def __init__(self, folder: Path, flight_id: str) -> None:
        self._folder = folder
        self._flight_id = flight_id
        self._frames: list[tuple[Any, ...]] = []
        self._places: list[FramePose] = []
        self._segments: list[FoundSegments] = []
        self._lines: list[FoundLines] = []
        self._signals: list[FoundSignals] = []
        self._n_waiting = 0
        self._connection = duckdb.connect(
            ":memory:", config=_CONFIG | {"temp_directory": str(folder / "spill")}
        )
        for statement in _row_tables():
            self._connection.execute(statement)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._connection.close()

    def add_frame(
        self,
        frame: Frame,
        detections: Detections | None,
        track_ids: Ints32 | None = None,
        track_scores: Floats32 | None = None,
        *,
        infer_ms: float | None = None,
        sharpness: float | None = None,
        mean_luma: float | None = None,
        place: FramePose = _NOWHERE,
        signals: Mapping[str, float | None] = _NO_SIGNALS,
    ) -> None:
        """Add a frame with its detections in source pixels, or a bad frame with None.

        Args:
            frame: The frame; its pixels are not read.
            detections: None exactly where `frame.error` is given.
            track_ids: The track of each line (N,), or None where lines were not tracked.
            track_scores: The score of the track of each line (N,), NaN or None where unknown.
            infer_ms: Inference time.
            sharpness: Variance of the Laplacian of the luma.
            mean_luma: 0 to 255.
            place: Position and attitude of the camera.
            signals: The numbers of other topics at its time, by their names.

        Raises:
            ValueError: Unless exactly one of `detections` and `frame.error` is given.
        """
        if (detections is None) == (frame.error is None):
            raise ValueError(f"frame {frame.frame_idx}: either detections or an error")
        height, width = detections.segments.image_size if detections else (0, 0)
        n_segments, n_lines = (len(detections.segments), len(detections.lines)) if detections else (0, 0)
        identity = (frame.channel_id, frame.frame_idx)
        times = (frame.log_time_ns, frame.stamp_ns)
        measures = (sharpness, mean_luma, infer_ms)
        self._frames.append(
            (*identity, *times, width, height, frame.error or frame.doubt, *measures, n_segments, n_lines)
        )
        self._places.append(place)
        if detections and n_segments:
            line_of = detections.line_of
            line_of = np.full(n_segments, -1, np.int32) if line_of is None else line_of
            self._segments.append(FoundSegments(*identity, detections.segments, line_of))
        if detections and n_lines:
            track_ids = np.full(n_lines, -1, np.int32) if track_ids is None else track_ids
            if track_scores is None:
                track_scores = np.full(n_lines, np.nan, np.float32)
            self._lines.append(FoundLines(*identity, detections.lines, track_ids, track_scores))
        if signals:
            self._signals.append(FoundSignals(*identity, signals))
        self._n_waiting += 1 + n_segments + n_lines + len(signals)
        if self._n_waiting >= _FLUSH_ROWS:
            self._flush()

    def finish(self, tracks: Iterable[tuple[int, TrackRow]] = ()) -> FlightTotals:
        """Write the parquet files, in the order in which frames were added, and return the row counts.

        No frame can be added afterwards, and no other file is left in the folder.

        Args:
            tracks: (channel_id, track) of every confirmed track; lines of other tracks get track_id NULL.
        """
        self._flush()
        if rows := list(tracks):
            self._insert(_INSERT_TRACKS, track_rows=track_columns(rows))
        self._execute(_DROP_LINES_OF_OTHER_TRACKS)
        for table in ROW_TABLES:
            path = str(self._folder / f"{table}.parquet")
            self._execute(_COPY.format(table=table), {"path": path})
        totals = FlightTotals(*self._execute(_TOTALS))
        self._connection.close()
        return totals

    def _flush(self) -> None:
        """Move the collected rows into the tables."""
        if self._frames:
            self._insert(_INSERT_FRAMES, frame_rows=frame_columns(self._frames, self._places))
        if self._segments:
            self._insert(_INSERT_SEGMENTS, segment_rows=segment_columns(self._segments))
        if self._lines:
            line_rows, point_rows = line_columns(self._lines)
            self._insert(_INSERT_LINES, line_rows=line_rows, point_rows=point_rows)
        if self._signals:
            self._insert(_INSERT_SIGNALS, signal_rows=signal_columns(self._signals))
        self._frames, self._places, self._segments, self._lines, self._signals = [], [], [], [], []
        self._n_waiting = 0

    def _insert(self, statement: str, **views: Columns) -> None:
        for name, columns in views.items():
            self._connection.register(name, columns)
        self._execute(statement, {"flight_id": self._flight_id})
        for name in views:
            self._connection.unregister(name)

    def _execute(self, statement: str, values: dict[str, str] | None = None) -> tuple[Any, ...]:
        try:
            return self._connection.execute(statement, values).fetchone() or ()
        except (duckdb.OperationalError, duckdb.FatalException) as error:
            problem = f"the rows cannot be written ({str(error).splitlines()[0]})"
            raise StoreError(self._folder, problem, "check the space on the disk, then run again") from error
