"""Frames, segments, lines and tracks as NumPy columns for DuckDB; NaN is NULL."""

from __future__ import annotations

from dataclasses import astuple, fields
from itertools import chain
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from inspect_pipeline.georeference.frame_pose import FramePose
from inspect_pipeline.tracking.tracker import TrackRow

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from inspect_pipeline.arrays import Floats32, Ints32
    from lsnet.segments import Lines, Segments

Columns = dict[str, "NDArray[Any]"]

_PLACE_DTYPES = {
    field.name: object if field.name == "attitude_source" else np.float64 for field in fields(FramePose)
}
_FRAME_DTYPES: dict[str, type] = {
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
    **_PLACE_DTYPES,
}
NULLABLE_FLOATS = tuple(name for name, dtype in _FRAME_DTYPES.items() if dtype in {np.float32, np.float64})


class FoundSegments(NamedTuple):
    """The segments of a frame, and the line of each (N,), -1 for none."""

    channel_id: int
    frame_idx: int
    segments: Segments
    line_of: Ints32


class FoundLines(NamedTuple):
    """The lines of a frame, the track of each (N,), and the score of that track, NaN where unknown."""

    channel_id: int
    frame_idx: int
    lines: Lines
    track_ids: Ints32
    track_scores: Floats32


class FoundSignals(NamedTuple):
    """The signals of a frame by their names, None where not known."""

    channel_id: int
    frame_idx: int
    values: Mapping[str, float | None]


def frame_columns(rows: Sequence[tuple[Any, ...]], places: Sequence[FramePose]) -> Columns:
    """Return the columns of frames; rows: channel_id to n_lines in order, None where unknown."""
    whole = [(*row, *astuple(place)) for row, place in zip(rows, places, strict=True)]
    return {
        name: _column(values, dtype)
        for (name, dtype), values in zip(_FRAME_DTYPES.items(), zip(*whole, strict=True), strict=True)
    }


def _column(values: Sequence[Any], dtype: type) -> NDArray[Any]:
    if dtype in {np.float32, np.float64}:
        return np.array([np.nan if value is None else value for value in values], dtype)
    return np.array(values, dtype)


def segment_columns(batches: Sequence[FoundSegments]) -> Columns:
    """Return one row per segment, in order."""
    counts = [len(batch.segments) for batch in batches]
    endpoints = np.concatenate([batch.segments.endpoints for batch in batches])
    return {
        "channel_id": np.repeat([batch.channel_id for batch in batches], counts),
        "frame_idx": np.repeat([batch.frame_idx for batch in batches], counts),
        "seg_idx": np.concatenate([np.arange(count) for count in counts]),
        **_chord_columns(endpoints),
        "length_px": np.hypot(endpoints[:, 2] - endpoints[:, 0], endpoints[:, 3] - endpoints[:, 1]),
        "score": np.concatenate([batch.segments.scores for batch in batches]),
        "line_idx": np.concatenate([batch.line_of for batch in batches]),
    }


def line_columns(batches: Sequence[FoundLines]) -> tuple[Columns, Columns]:
    """Return one row per line, and one per point, related by row_idx."""
    points = list(chain.from_iterable(batch.lines.points for batch in batches))
    counts = [len(batch.lines) for batch in batches]
    n_points = [len(p) for p in points]
    line_rows = {
        "row_idx": np.arange(len(points)),
        "channel_id": np.repeat([batch.channel_id for batch in batches], counts),
        "frame_idx": np.repeat([batch.frame_idx for batch in batches], counts),
        "line_idx": np.concatenate([np.arange(count) for count in counts]),
        "n_points": np.array(n_points),
        **_chord_columns(np.array([(*p[0], *p[-1]) for p in points], np.float32)),
        "length_px": np.array([np.hypot(*np.diff(p, axis=0).T).sum() for p in points], np.float32),
        "score": np.concatenate([batch.lines.scores for batch in batches]),
        "track_id": np.concatenate([batch.track_ids for batch in batches]),
        "track_score": np.concatenate([batch.track_scores for batch in batches]),
    }
    flat = np.concatenate(points)
    point_rows = {
        "row_idx": np.repeat(np.arange(len(points)), n_points),
        "point_idx": np.concatenate([np.arange(count) for count in n_points]),
        "x": flat[:, 0].copy(),
        "y": flat[:, 1].copy(),
    }
    return line_rows, point_rows


def signal_columns(batches: Sequence[FoundSignals]) -> Columns:
    """Return one row per frame and signal, in order."""
    return {
        "channel_id": np.array([batch.channel_id for batch in batches for _ in batch.values]),
        "frame_idx": np.array([batch.frame_idx for batch in batches for _ in batch.values]),
        "name": np.array([name for batch in batches for name in batch.values], object),
        "value": _column([value for batch in batches for value in batch.values.values()], np.float64),
    }


def track_columns(tracks: Sequence[tuple[int, TrackRow]]) -> Columns:
    """Return one row per (channel_id, track), in order."""
    names = ("channel_id", *(field.name for field in fields(TrackRow)))
    rows = [(channel_id, *astuple(track)) for channel_id, track in tracks]
    return {name: np.array(values) for name, values in zip(names, zip(*rows, strict=True), strict=True)}


def _chord_columns(endpoints: Floats32) -> Columns:
    """Return x1 to y2 and the angle in degrees, in [0, 180): 180 after rounding to float32 becomes 0."""
    x1, y1, x2, y2 = (column.copy() for column in endpoints.T)
    angle_deg = np.degrees(np.arctan2(y2 - y1, x2 - x1)).astype(np.float32) % np.float32(180)
    angle_deg[angle_deg == 180] = 0
    return {"x1": x1, "y1": y1, "x2": x2, "y2": y2, "angle_deg": angle_deg}
