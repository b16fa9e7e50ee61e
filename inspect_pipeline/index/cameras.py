"""The rows of a flight as the inspection takes them, by camera."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from inspect_pipeline.index.inspected import load_store_rules
from inspect_pipeline.index.reading import select
from inspect_pipeline.inspection.places import see_place
from inspect_pipeline.inspection.rows import CameraRows, FrameRows, LineRows
from inspect_pipeline.inspection.spans import load_spans

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    import duckdb
    from numpy.typing import NDArray

    from inspect_pipeline.arrays import Floats
    from inspect_pipeline.store.store import Store

    Row = Mapping[str, Any]

_FRAMES = """
SELECT channel_id, frame_idx, log_time_ns, stamp_ns,
       coalesce(width, -1) AS width, coalesce(height, -1) AS height,
       status = 'ok' AS is_ok, sharpness, mean_luma, lat_deg, lon_deg, height_m, cam_yaw_deg, cam_pitch_deg,
       cam_roll_deg, pose_age_ms, focal_px, gsd_m, ground_lat_deg, ground_lon_deg, rise_m,
       coalesce(attitude_source = 'camera', false) AS is_turn_known
FROM frames
WHERE flight_id = $flight_id
ORDER BY channel_id, frame_idx
"""
_STILLS = "SELECT channel_id FROM channels WHERE flight_id = $flight_id AND is_stills"
_LINES = """
SELECT channel_id, frame_idx, coalesce(track_id, -1) AS track_id, n_points
FROM lines
WHERE flight_id = $flight_id
ORDER BY channel_id, frame_idx, line_idx
"""
_POINTS = """
SELECT channel_id, point.x, point.y
FROM (
    SELECT channel_id, frame_idx, line_idx, unnest(points) AS point, generate_subscripts(points, 1) AS number
    FROM lines
    WHERE flight_id = $flight_id
)
ORDER BY channel_id, frame_idx, line_idx, number
"""


_RISES = """
SELECT lat_deg, lon_deg, rise_m FROM frames
WHERE flight_id = ? AND rise_m IS NOT NULL
ORDER BY channel_id, frame_idx
"""
_MAX_RISES = 1000


def load_places(store: Store, flight_id: str) -> Callable[[Row, Sequence[Row]], Floats]:
    """Return what finds the place of an anomaly of a flight in frames, see `see_place`; raises StoreError."""
    rules, spans = load_store_rules(store), {span.span_id: span for span in load_spans(store)}
    rows = select(store, _RISES, [flight_id])
    rises = np.array([[row["lat_deg"], row["lon_deg"], row["rise_m"]] for row in rows]).reshape(-1, 3)
    rises = rises[:: max(1, len(rises) // _MAX_RISES)]
    return lambda anomaly, frames: see_place(anomaly, spans.get(anomaly["span_id"]), frames, rules, rises)


def load_cameras(connection: duckdb.DuckDBPyConnection, flight_id: str) -> list[CameraRows]:
    """Load the rows of a flight, by camera."""
    key = {"flight_id": flight_id}
    frames, lines, points = (_rows_by_camera(connection, sql, key) for sql in (_FRAMES, _LINES, _POINTS))
    stills = {channel_id for (channel_id,) in connection.execute(_STILLS, key).fetchall()}
    return [
        CameraRows(
            channel_id,
            FrameRows(**columns),
            _line_rows(columns["frame_idx"], lines.get(channel_id), points.get(channel_id)),
            is_stills=channel_id in stills,
        )
        for channel_id, columns in frames.items()
    ]


def _rows_by_camera(
    connection: duckdb.DuckDBPyConnection, sql: str, values: dict[str, Any]
) -> dict[int, dict[str, NDArray[Any]]]:
    """Return the columns of rows that are ordered by channel_id, for each of these."""
    columns = {name: _plain(found) for name, found in connection.execute(sql, values).fetchnumpy().items()}
    channel_ids = columns.pop("channel_id")
    of_camera, first = np.unique(channel_ids, return_index=True)
    last = np.append(first, len(channel_ids))[1:]
    return {
        int(channel_id): {name: found[start:end] for name, found in columns.items()}
        for channel_id, start, end in zip(of_camera, first, last, strict=True)
    }


def _line_rows(
    frame_idx: NDArray[Any], lines: dict[str, NDArray[Any]] | None, points: dict[str, NDArray[Any]] | None
) -> LineRows:
    """Return the lines of a camera with frames of these indices."""
    none = np.empty(0, np.int64)
    lines = lines or {"frame_idx": none, "track_id": none, "n_points": none}
    points = points or {"x": none, "y": none}
    return LineRows(
        frame=np.searchsorted(frame_idx, lines["frame_idx"]).astype(np.int64),
        track=lines["track_id"].astype(np.int64),
        first=np.concatenate(([0], np.cumsum(lines["n_points"]))).astype(np.int64),
        points=np.column_stack((points["x"], points["y"])).astype(np.float64),
    )


def _plain(values: NDArray[Any]) -> NDArray[Any]:
    """Remove the mask of a column: floats get NaN for NULL, integers and booleans stay as they are."""
    if values.dtype.kind == "f":
        filled: NDArray[Any] = np.ma.filled(values.astype(np.float64), np.nan)
        return filled
    plain: NDArray[Any] = np.ma.getdata(values)
    return plain.astype(np.int64) if plain.dtype.kind in "iu" else plain
