"""The pose of a frame; a module of its own, because `frames` imports SciPy, which takes long."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class FramePose:
    """The columns of `frames` that say where and how it was taken; None where it is not known.

    attitude_source: "camera", "vehicle" for a camera taken to look straight down out of the vehicle, "nadir"
    for one taken to look straight down, None without a position. focal_px is in pixels of this frame.
    rise_m: of the ground below since the first position, by a terrain model; height_m is above that ground.
    gsd_m and wire_px are those at the middle of the image, on the ground.
    """

    lat_deg: float | None = None
    lon_deg: float | None = None
    alt_m: float | None = None
    height_m: float | None = None
    heading_deg: float | None = None
    cam_roll_deg: float | None = None
    cam_pitch_deg: float | None = None
    cam_yaw_deg: float | None = None
    pose_age_ms: float | None = None
    attitude_source: str | None = None
    focal_px: float | None = None
    gsd_m: float | None = None
    ground_lat_deg: float | None = None
    ground_lon_deg: float | None = None
    wire_px: float | None = None
    rise_m: float | None = None
