"""Track the lines of a flight: one tracker for each camera, compensated for camera rotation."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from inspect_pipeline.geometry.attitude import YawPitchRoll
from inspect_pipeline.tracking.camera_motion import CameraMotion
from inspect_pipeline.tracking.tracker import FrameInfo, LineTracker

if TYPE_CHECKING:
    from collections.abc import Iterator

    from inspect_pipeline.arrays import Ints32
    from inspect_pipeline.georeference.frame_pose import FramePose
    from inspect_pipeline.recording.types import Frame
    from inspect_pipeline.tracking.tracker import TrackRow
    from lsnet.segments import Lines

_MEASURED_ATTITUDES = frozenset({"camera", "vehicle"})


class FlightTracker:
    """Track the lines of all cameras of a flight. Frames of a camera are given in time order."""

    def __init__(self) -> None:
        self._cameras: dict[int, _CameraTracker] = {}

    def follow(self, frame: Frame, lines: Lines, pose: FramePose) -> Ints32:
        """Return the track id of each line of a frame (N,), counted from 0 in each camera."""
        camera = self._cameras.setdefault(frame.channel_id, _CameraTracker())
        return camera.follow(FrameInfo(frame.frame_idx, frame.log_time_ns, lines.image_size), lines, pose)

    def finish(self) -> Iterator[tuple[int, TrackRow]]:
        """Yield (channel_id, track) of all confirmed tracks. Other track ids are to be discarded."""
        for channel_id, camera in self._cameras.items():
            for row in camera.tracker.finish():
                yield channel_id, row


class _CameraTracker:
    def __init__(self) -> None:
        self.tracker = LineTracker()
        self._motion = CameraMotion()

    def follow(self, frame: FrameInfo, lines: Lines, pose: FramePose) -> Ints32:
        chords = np.array([(*points[0], *points[-1]) for points in lines.points]).reshape(-1, 4)
        motion = self._motion.update(_attitude(pose), frame.time_ns, pose.focal_px, frame.image_size)
        return self.tracker.update(frame, chords, lines.scores, motion)


def _attitude(pose: FramePose) -> YawPitchRoll | None:
    """Return the attitude of the camera, None where it is assumed and not measured."""
    angles = pose.cam_yaw_deg, pose.cam_pitch_deg, pose.cam_roll_deg
    if pose.attitude_source not in _MEASURED_ATTITUDES or None in angles:
        return None
    return YawPitchRoll(*(angle for angle in angles if angle is not None))
