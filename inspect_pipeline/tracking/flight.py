"""The lines of a flight followed: a tracker for each of its cameras, which is told how the camera turned."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from inspect_pipeline.geometry.attitude import YawPitchRoll
from inspect_pipeline.tracking.camera_motion import CameraMotion
from inspect_pipeline.tracking.tracker import LineTracker, Moment

if TYPE_CHECKING:
    from collections.abc import Iterator

    from inspect_pipeline.arrays import Ints32
    from inspect_pipeline.georeference.frames import FramePose
    from inspect_pipeline.recording.types import Frame
    from inspect_pipeline.tracking.tracker import TrackRow
    from lsnet.segments import Lines

_KNOWN_ATTITUDES = frozenset({"camera", "vehicle"})


class FlightTracker:
    """Follows the lines of the frames of a flight, which come in the order of time."""

    def __init__(self) -> None:
        self._cameras: dict[int, _CameraTracker] = {}

    def follow(self, frame: Frame, lines: Lines, place: FramePose) -> Ints32:
        """The track of each line of a frame, counted from 0 in each camera."""
        camera = self._cameras.setdefault(frame.channel_id, _CameraTracker())
        return camera.follow(Moment(frame.frame_idx, frame.log_time_ns, lines.image_size), lines, place)

    def finish(self) -> Iterator[tuple[int, TrackRow]]:
        """(channel_id, track) of all confirmed tracks; lines of others belong to none."""
        for channel_id, camera in self._cameras.items():
            for row in camera.tracker.finish():
                yield channel_id, row


class _CameraTracker:
    def __init__(self) -> None:
        self.tracker = LineTracker()
        self._turn = CameraMotion()

    def follow(self, moment: Moment, lines: Lines, place: FramePose) -> Ints32:
        chords = np.array([(*points[0], *points[-1]) for points in lines.points]).reshape(-1, 4)
        motion = self._turn.update(_turns(place), moment.time_ns, place.focal_px, moment.image_size)
        return self.tracker.update(moment, chords, lines.scores, motion)


def _turns(place: FramePose) -> YawPitchRoll | None:
    """How the camera is turned in the world, None where that is assumed."""
    turns = place.cam_yaw_deg, place.cam_pitch_deg, place.cam_roll_deg
    if place.attitude_source not in _KNOWN_ATTITUDES or None in turns:
        return None
    return YawPitchRoll(*(turn for turn in turns if turn is not None))
