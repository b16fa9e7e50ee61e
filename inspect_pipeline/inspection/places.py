"""Where the place of an anomaly on a span is in the images of frames."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from inspect_pipeline.geometry.camera import CameraPoses, camera_axes
from inspect_pipeline.geometry.local_frame import LocalMetres
from inspect_pipeline.inspection.span_view import make_axis
from inspect_pipeline.inspection.terrain import Ground

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from typing import Any

    from inspect_pipeline.arrays import Floats
    from inspect_pipeline.inspection.rules import Rules
    from inspect_pipeline.inspection.spans import Span

_POSE = ("lat_deg", "lon_deg", "height_m", "cam_yaw_deg", "cam_pitch_deg", "cam_roll_deg", "focal_px")
PLACE_COLUMNS = (*_POSE, "rise_m", "width", "height")  # of frames


def see_place(
    anomaly: Mapping[str, Any],
    span: Span | None,
    frames: Sequence[Mapping[str, Any]],
    rules: Rules,
    rises: Floats,
) -> Floats:
    """Return the pixel of the place in each frame and the metres per pixel there.

    The place is on the axis of the span, at the height of the conductors.

    Args:
        anomaly: a row of the table anomalies.
        span: its span, None for one without.
        frames: rows of the table frames, with PLACE_COLUMNS.
        rules: for the heights that are not known.
        rises: (S, 3) latitude, longitude and rise of the ground in m, where a terrain model gave it.

    Returns:
        (N, 3) x, y and metres per pixel; NaN where the place is not in the image, or this is not known.
    """
    seen = np.full((len(frames), 3), np.nan)
    posed = [i for i, row in enumerate(frames) if all(row[name] is not None for name in _POSE)]
    if span is None or not posed or anomaly["lat_deg"] is None:
        return seen
    origin = LocalMetres(anomaly["lat_deg"], anomaly["lon_deg"])
    ground = Ground(origin.to_metres(rises[:, 0], rises[:, 1]), rises[:, 2])
    centres = make_axis(span, origin, rules, ground).centres
    point = centres[np.hypot(*centres[:, :2].T).argmin()]
    columns = np.array([[frames[i][name] for name in _POSE] for i in posed], np.float64)
    heights_m = columns[:, 2] + [frames[i]["rise_m"] or 0.0 for i in posed]
    poses = CameraPoses(
        positions=np.column_stack((origin.to_metres(columns[:, 0], columns[:, 1]), heights_m)),
        axes=camera_axes(columns[:, 3:6]),
        focal_px=columns[:, 6],
        sizes=np.array([[frames[i]["width"], frames[i]["height"]] for i in posed], np.float64),
    )
    pixels, depths = poses.project(point[np.newaxis])
    pixels, depths = pixels[:, 0], depths[:, 0]
    is_inside = (depths > 0) & ((pixels > 0) & (pixels < poses.sizes)).all(axis=1)
    found = np.column_stack((pixels, depths / poses.focal_px))
    seen[posed] = np.where(is_inside[:, np.newaxis], found, np.nan)
    return seen
