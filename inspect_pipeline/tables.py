"""The tables: made by numbered migrations, and filled with the rows of one flight, frame by frame.

The rows become frames, segments, lines and tracks.parquet. They wait in NumPy columns,
then in an in-memory DuckDB that spills into the flight's folder, so memory stays bounded however many
segments a flight has.
"""

from __future__ import annotations

from datetime import UTC, datetime
from importlib.metadata import version
from itertools import chain
from typing import TYPE_CHECKING, Any, Self

import duckdb
import numpy as np

from inspect_pipeline.errors import StoreError
from inspect_pipeline.flight import FlightTotals
from inspect_pipeline.resources import MIGRATIONS, read_schema

if TYPE_CHECKING:
    from pathlib import Path
    from types import TracebackType

    from numpy.typing import NDArray

    from inspect_pipeline.types import Frame
    from lsnet.segments import Detections, Lines, Segments

Columns = dict[str, "NDArray[Any]"]

ROW_TABLES = ("frames", "segments", "lines", "tracks")

_FLUSH_ROWS = 65_536
_CONFIG: dict[str, str | bool | int | float | list[str]] = {
    "memory_limit": "96MB",
    "threads": "1",
    "python_enable_replacements": "false",
}

_INSERT_FRAMES = """
INSERT INTO frames BY NAME
SELECT $flight_id AS flight_id,
       * REPLACE (nullif(width, 0) AS width, nullif(height, 0) AS height,
                  if(isnan(sharpness), NULL, sharpness) AS sharpness,
                  if(isnan(mean_luma), NULL, mean_luma) AS mean_luma,
                  if(isnan(infer_ms), NULL, infer_ms) AS infer_ms),
       if(reason IS NULL, 'ok', 'bad') AS status
FROM frame_rows
"""
_INSERT_SEGMENTS = "INSERT INTO segments BY NAME SELECT $flight_id AS flight_id, * FROM segment_rows"
_INSERT_LINES = """
INSERT INTO lines BY NAME
SELECT $flight_id AS flight_id, l.* EXCLUDE (row_idx), p.points
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
_FRAME_DTYPES = {
    "channel_id": np.int32,
    "frame_idx": np.int32,
    "log_time_ns": np.int64,
    "stamp_ns": np.int64,
    "width": np.int32,
    "height": np.int32,
    "reason": object,
    "sharpness": np.float32,
    "mean_luma": np.float32,
    "infer_ms": np.float32,
    "n_segments": np.int32,
    "n_lines": np.int32,
}


def create_tables(connection: duckdb.DuckDBPyConnection) -> None:
    """Apply the migrations that a database lacks, each in a transaction."""
    applied = count_migrations(connection)
    for number, name in enumerate(MIGRATIONS[applied:], applied + 1):
        connection.begin()
        connection.execute(read_schema(name))
        connection.execute(
            "INSERT INTO schema_version VALUES (?, ?, ?)",
            [number, datetime.now(UTC).replace(tzinfo=None), version("lsnet-pipe")],
        )
        connection.commit()


def count_migrations(connection: duckdb.DuckDBPyConnection) -> int:
    """How many migrations were applied to a database."""
    try:
        row = connection.execute("SELECT max(version) FROM schema_version").fetchone()
    except duckdb.CatalogException:
        return 0
    return int(row[0]) if row and row[0] else 0


class FlightWriter:
    """Writes the rows of flight `flight_id` into `folder`; `finish` makes the files.

    Raises StoreError when the folder cannot be written.
    """

    def __init__(self, folder: Path, flight_id: str) -> None:
        self._folder = folder
        self._flight_id = flight_id
        self._frames: list[tuple[Any, ...]] = []
        self._segments: list[tuple[int, int, Segments]] = []
        self._lines: list[tuple[int, int, Lines]] = []
        self._n_waiting = 0
        self._connection = duckdb.connect(
            ":memory:", config=_CONFIG | {"temp_directory": str(folder / "spill")}
        )
        create_tables(self._connection)

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
        *,
        infer_ms: float | None = None,
        sharpness: float | None = None,
        mean_luma: float | None = None,
    ) -> None:
        """Add a frame with what was found in it, in source pixels, or a bad frame with None.

        Raises ValueError unless exactly one of `detections` and `frame.error` is given.
        """
        if (detections is None) == (frame.error is None):
            raise ValueError(f"frame {frame.frame_idx}: either detections or an error")
        height, width = frame.image.shape[:2] if frame.image is not None else (0, 0)
        n_segments, n_lines = (len(detections.segments), len(detections.lines)) if detections else (0, 0)
        identity = (frame.channel_id, frame.frame_idx)
        times = (frame.log_time_ns, frame.stamp_ns)
        measures = (_nan_if_none(sharpness), _nan_if_none(mean_luma), _nan_if_none(infer_ms))
        self._frames.append((*identity, *times, width, height, frame.error, *measures, n_segments, n_lines))
        if detections and n_segments:
            self._segments.append((*identity, detections.segments))
        if detections and n_lines:
            self._lines.append((*identity, detections.lines))
        self._n_waiting += 1 + n_segments + n_lines
        if self._n_waiting >= _FLUSH_ROWS:
            self._flush()

    def finish(self) -> FlightTotals:
        """Write the parquet files, in the order the frames were added, and return what they hold.

        Nothing can be added afterwards, and nothing else is left in the folder.
        """
        self._flush()
        for table in ROW_TABLES:
            path = str(self._folder / f"{table}.parquet")
            self._execute(_COPY.format(table=table), {"path": path})
        totals = FlightTotals(*self._execute(_TOTALS))
        self._connection.close()
        return totals

    def _flush(self) -> None:
        """Move the waiting rows into the tables."""
        if self._frames:
            self._insert(_INSERT_FRAMES, frame_rows=_frame_columns(self._frames))
        if self._segments:
            self._insert(_INSERT_SEGMENTS, segment_rows=_segment_columns(self._segments))
        if self._lines:
            line_rows, point_rows = _line_columns(self._lines)
            self._insert(_INSERT_LINES, line_rows=line_rows, point_rows=point_rows)
        self._frames, self._segments, self._lines, self._n_waiting = [], [], [], 0

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


def _frame_columns(rows: list[tuple[Any, ...]]) -> Columns:
    return {
        name: np.array(column, dtype)
        for (name, dtype), column in zip(_FRAME_DTYPES.items(), zip(*rows, strict=True), strict=True)
    }


def _segment_columns(batches: list[tuple[int, int, Segments]]) -> Columns:
    """One row per segment, in order."""
    counts = [len(segments) for _, _, segments in batches]
    endpoints = np.concatenate([segments.endpoints for _, _, segments in batches])
    return {
        "channel_id": np.repeat([channel_id for channel_id, _, _ in batches], counts),
        "frame_idx": np.repeat([frame_idx for _, frame_idx, _ in batches], counts),
        "seg_idx": np.concatenate([np.arange(count) for count in counts]),
        **_chord_columns(endpoints),
        "length_px": np.hypot(endpoints[:, 2] - endpoints[:, 0], endpoints[:, 3] - endpoints[:, 1]),
        "score": np.concatenate([segments.scores for _, _, segments in batches]),
    }


def _line_columns(batches: list[tuple[int, int, Lines]]) -> tuple[Columns, Columns]:
    """One row per line, and one per point of them, bound by row_idx."""
    points = list(chain.from_iterable(lines.points for _, _, lines in batches))
    counts = [len(lines) for _, _, lines in batches]
    n_points = [len(p) for p in points]
    line_rows = {
        "row_idx": np.arange(len(points)),
        "channel_id": np.repeat([channel_id for channel_id, _, _ in batches], counts),
        "frame_idx": np.repeat([frame_idx for _, frame_idx, _ in batches], counts),
        "line_idx": np.concatenate([np.arange(count) for count in counts]),
        "n_points": np.array(n_points),
        **_chord_columns(np.array([(*p[0], *p[-1]) for p in points], np.float32)),
        "length_px": np.array([np.hypot(*np.diff(p, axis=0).T).sum() for p in points], np.float32),
        "score": np.concatenate([lines.scores for _, _, lines in batches]),
    }
    flat = np.concatenate(points)
    point_rows = {
        "row_idx": np.repeat(np.arange(len(points)), n_points),
        "point_idx": np.concatenate([np.arange(count) for count in n_points]),
        "x": flat[:, 0].copy(),
        "y": flat[:, 1].copy(),
    }
    return line_rows, point_rows


def _chord_columns(endpoints: NDArray[np.float32]) -> Columns:
    """x1 to y2 and the angle in degrees, in [0, 180): rounding to float32 may give 180, which is 0."""
    x1, y1, x2, y2 = (column.copy() for column in endpoints.T)
    angle_deg = np.degrees(np.arctan2(y2 - y1, x2 - x1)).astype(np.float32) % np.float32(180)
    angle_deg[angle_deg == 180] = 0
    return {"x1": x1, "y1": y1, "x2": x2, "y2": y2, "angle_deg": angle_deg}


def _nan_if_none(value: float | None) -> float:
    return float("nan") if value is None else value
