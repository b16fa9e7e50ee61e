"""A camera that looks straight down on a span, as rows made by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from inspect_pipeline.geometry.local_frame import LocalMetres
from inspect_pipeline.inspection.rows import CameraRows, FrameRows, LineRows
from inspect_pipeline.inspection.rules import Rules, load_rules
from inspect_pipeline.inspection.spans import Span

ORIGIN = LocalMetres(52.0, 5.0)
PERIOD_NS = 100_000_000
SIDE_PX, FOCAL_PX = 1000, 1000.0


def rules(**changes: float) -> Rules:
    shipped = load_rules()
    return replace(shipped, coverage={**shipped.coverage, "sag_share": 0.0, **changes})


def span(length_m: float = 100.0, height_m: float = 10.0, expected: int | None = None) -> Span:
    """It runs to the east from the origin."""
    lat, lon = ORIGIN.to_degrees(np.array([length_m, 0.0]))
    return Span(
        "A-B", "L", "A", "B", 52.0, 5.0, height_m, float(lat), float(lon), height_m, length_m, expected
    )


def flight(
    along_m: np.ndarray, seen: np.ndarray, height_m: float = 30.0, times_ns: np.ndarray | None = None
) -> CameraRows:
    """Frames over the span, the top of the picture to the east; `seen` frames have one line up the middle."""
    n = len(along_m)
    lat_deg, lon_deg = ORIGIN.to_degrees(np.column_stack((along_m, np.zeros(n))))
    times_ns = np.arange(n) * PERIOD_NS if times_ns is None else times_ns
    frames = FrameRows(
        frame_idx=np.arange(n),
        log_time_ns=times_ns,
        stamp_ns=times_ns,
        width=np.full(n, SIDE_PX),
        height=np.full(n, SIDE_PX),
        is_ok=np.ones(n, bool),
        sharpness=np.full(n, 100.0),
        mean_luma=np.full(n, 100.0),
        lat_deg=lat_deg,
        lon_deg=lon_deg,
        height_m=np.full(n, height_m),
        cam_yaw_deg=np.full(n, 90.0),
        cam_pitch_deg=np.full(n, -90.0),
        cam_roll_deg=np.zeros(n),
        pose_age_ms=np.zeros(n),
        focal_px=np.full(n, FOCAL_PX),
        gsd_m=np.full(n, height_m / FOCAL_PX),
        ground_lat_deg=lat_deg,
        ground_lon_deg=lon_deg,
        rise_m=np.full(n, np.nan),
        is_turn_known=np.ones(n, bool),
    )
    rows = np.flatnonzero(seen)
    points = np.tile([[SIDE_PX / 2, 0.0], [SIDE_PX / 2, SIDE_PX]], (len(rows), 1))
    return CameraRows(
        1, frames, LineRows(rows, np.zeros(len(rows), int), 2 * np.arange(len(rows) + 1), points)
    )
