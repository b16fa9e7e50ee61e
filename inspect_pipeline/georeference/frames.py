"""Georeference frames: compute position, direction and ground sample distance.

placer = Georeferencer.of(recording, options)
place = placer.place(frame)     # the columns of a row of `frames`
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from inspect_pipeline.geometry.attitude import YawPitchRoll
from inspect_pipeline.geometry.camera import lens_of_view, pixel_rays, resized, turned_down
from inspect_pipeline.geometry.local_frame import LocalMetres
from inspect_pipeline.geometry.terrain import load_elevation, meet_ground, meet_terrain
from inspect_pipeline.georeference.calibration import LensReader
from inspect_pipeline.georeference.frame_pose import FramePose
from inspect_pipeline.georeference.poses import read_poses

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import ArrayLike

    from inspect_pipeline.arrays import Floats
    from inspect_pipeline.config import PlacingOptions
    from inspect_pipeline.geometry.camera import Intrinsics
    from inspect_pipeline.geometry.terrain import Elevation
    from inspect_pipeline.georeference.calibration import LensTrack
    from inspect_pipeline.georeference.poses import Pose, PoseTrack
    from inspect_pipeline.recording.reader import Recording
    from inspect_pipeline.recording.types import Frame


_STRAIGHT_DOWN_DEG = -90.0


@dataclass(frozen=True, slots=True)
class Georeferencer:
    """Places the frames of a recording by its poses and its cameras' lenses, by channel id.

    The ground is flat, or rises and falls with the terrain from where the recording begins.
    """

    poses: PoseTrack
    lenses: Mapping[int, LensTrack]
    options: PlacingOptions
    terrain: Elevation | None = None

    @classmethod
    def of(cls, recording: Recording, options: PlacingOptions) -> Georeferencer:
        """Read poses, lenses and terrain.

        Raises RecordingError when chunks of a `strict` recording cannot be read, TerrainError.
        """
        terrain = load_elevation(options.terrain) if options.terrain else None
        lenses = LensReader(recording)
        poses = read_poses(recording, lenses)
        return cls(poses, lenses.lenses(), options, terrain)

    def place(self, frame: Frame) -> FramePose:
        """Georeference a frame from the last pose known at its log time."""
        pose, lens = self.poses.at(frame.log_time_ns), self._lens(frame)
        focal_px = lens.focal_px[0] if lens else None
        if pose is None:
            return FramePose(focal_px=focal_px)
        turns, source = _camera_turns(pose)
        rise_m = self._rise_m(pose)
        height_m = self._height_m(pose, rise_m)
        sight = self._sight(pose, turns, height_m, lens)
        gsd_m = sight.distance_m / focal_px if sight and focal_px else None
        return FramePose(
            lat_deg=pose.latitude_deg,
            lon_deg=pose.longitude_deg,
            alt_m=pose.altitude_m,
            height_m=height_m,
            heading_deg=pose.heading_deg,
            cam_roll_deg=turns.roll_deg,
            cam_pitch_deg=turns.pitch_deg,
            cam_yaw_deg=turns.yaw_deg if source != "nadir" else None,
            pose_age_ms=pose.age_ms,
            attitude_source=source if pose.latitude_deg is not None else None,
            focal_px=focal_px,
            gsd_m=gsd_m,
            ground_lat_deg=sight.lat_deg if sight else None,
            ground_lon_deg=sight.lon_deg if sight else None,
            wire_px=self.options.wire_m / gsd_m if gsd_m else None,
            rise_m=rise_m if height_m is not None else None,
        )

    def _lens(self, frame: Frame) -> Intrinsics | None:
        """Return the lens in pixels of the frame, which may be smaller than the calibrated image."""
        if frame.image is None:
            return None
        height, width = frame.image.shape[:2]
        track, view_deg = self.lenses.get(frame.channel_id), self.options.view_deg
        if track and not (track.is_nominal and view_deg is not None):
            lens = track.at(frame.log_time_ns)
            return lens if lens.image_size == (height, width) else resized(lens, (height, width))
        return lens_of_view((height, width), view_deg) if view_deg is not None else None

    def _rise_m(self, pose: Pose) -> float | None:
        """Return the height of the ground above that below the first position; None without a terrain."""
        if self.terrain is None or pose.latitude_deg is None or pose.longitude_deg is None:
            return None
        begin = self.poses.positions.values[0]
        (rise_m,) = _rise_m(self.terrain, (begin[0], begin[1]), [pose.latitude_deg], [pose.longitude_deg])
        return float(rise_m) if np.isfinite(rise_m) else None

    def _height_m(self, pose: Pose, rise_m: float | None) -> float | None:
        """Return the height above ground: from the given altitude of the ground, else from the recording."""
        height_m = pose.height_m
        if self.options.ground_alt_m is not None and pose.altitude_m is not None:
            height_m = pose.altitude_m - self.options.ground_alt_m
        if self.terrain is None or height_m is None:
            return height_m
        return height_m - rise_m if rise_m is not None else None

    def _meet_ground(self, here: tuple[float, float], height_m: float, ray: Floats) -> Floats:
        """Return (3,) metres east, north and up from the camera to the ground along a ray (3,), or NaN."""
        terrain = self.terrain
        if terrain is None:
            met: Floats = meet_ground(ray[np.newaxis], height_m)[0]
            return met
        return meet_terrain(
            ray,
            height_m,
            lambda east, north: _rise_m(
                terrain, here, *LocalMetres(*here).to_degrees(np.stack((east, north), axis=-1))
            ),
        )

    def _sight(
        self, pose: Pose, turns: YawPitchRoll, height_m: float | None, lens: Intrinsics | None
    ) -> _Sight | None:
        """Intersect the optical axis with the ground; None where that is unknown, above or out of sight."""
        if pose.latitude_deg is None or pose.longitude_deg is None or height_m is None or height_m <= 0:
            return None
        lens = lens or lens_of_view((2, 2), 90.0)  # any lens: the image centre is on the optical axis
        height, width = lens.image_size
        here = pose.latitude_deg, pose.longitude_deg
        met = self._meet_ground(here, height_m, pixel_rays(lens, turns, (width / 2, height / 2))[0])
        if np.isnan(met).any():
            return None
        lat_deg, lon_deg = LocalMetres(*here).to_degrees(met[:2])
        return _Sight(float(lat_deg), float(lon_deg), float(np.linalg.norm(met)))


def _rise_m(terrain: Elevation, begin: tuple[float, float], lat_deg: ArrayLike, lon_deg: ArrayLike) -> Floats:
    """Return (N,) heights in m of the ground at (N,) positions above that at the first one."""
    below_m = terrain.at(*(np.array([degrees]) for degrees in begin))
    rise_m: Floats = terrain.at(np.asarray(lat_deg), np.asarray(lon_deg)) - below_m
    return rise_m


def _camera_turns(pose: Pose) -> tuple[YawPitchRoll, str]:
    """Return the attitude of the camera and its source."""
    if pose.yaw_deg is None or pose.pitch_deg is None or pose.roll_deg is None:
        return YawPitchRoll(0.0, _STRAIGHT_DOWN_DEG, 0.0), "nadir"
    turns = YawPitchRoll(pose.yaw_deg, pose.pitch_deg, pose.roll_deg)
    return (turns, "camera") if pose.attitude_of == "camera" else (turned_down(turns), "vehicle")


@dataclass(frozen=True, slots=True)
class _Sight:
    """The ground point at the image centre, and its distance."""

    lat_deg: float
    lon_deg: float
    distance_m: float
