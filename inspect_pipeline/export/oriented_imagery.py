"""The table that ArcGIS reads to make an oriented imagery dataset: the pose of the camera for each image."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from inspect_pipeline.export.text import plain

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

ORIENTED_IMAGERY_FILE = "oriented_imagery.csv"
ORIENTED_IMAGERY_FIELDS = (
    "Name",
    "ImagePath",
    "AcquisitionDate",
    "SRS",
    "X",
    "Y",
    "Z",
    "CameraHeading",
    "CameraPitch",
    "CameraRoll",
    "HorizontalFieldOfView",
    "VerticalFieldOfView",
    "CameraHeight",
    "OrientedImageryType",
)
_NADIR_DEG = -75.0  # pitch up to which the camera counts as looking down


def to_oriented_image(path: Path, row: Mapping[str, Any]) -> dict[str, Any] | None:
    """Return the table's row for an image; None without a position, which it requires.

    Its pitch is 0 straight down and 90 at the horizon. Z is the altitude as the recording counts it.
    """
    if row["lat_deg"] is None or row["lon_deg"] is None:
        return None
    pitch_deg, yaw_deg = row["cam_pitch_deg"], row["cam_yaw_deg"]
    values = (
        path.stem,
        str(path.absolute()),
        plain(row["log_time_utc"]),
        4326,
        row["lon_deg"],
        row["lat_deg"],
        row["alt_m"],
        None if yaw_deg is None else yaw_deg % 360,
        None if pitch_deg is None else pitch_deg + 90,
        row["cam_roll_deg"],
        _view_deg(row["width"], row["focal_px"]),
        _view_deg(row["height"], row["focal_px"]),
        row["height_m"],
        "Nadir" if pitch_deg is None or pitch_deg <= _NADIR_DEG else "Oblique",
    )
    return dict(zip(ORIENTED_IMAGERY_FIELDS, values, strict=True))


def _view_deg(size_px: int, focal_px: float | None) -> float | None:
    return math.degrees(2 * math.atan(size_px / 2 / focal_px)) if focal_px else None
