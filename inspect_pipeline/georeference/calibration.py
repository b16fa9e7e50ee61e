"""The calibrations of each camera of a recording, over time."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, field
from itertools import takewhile
from typing import TYPE_CHECKING

from inspect_pipeline.messages.calibration import parser_for
from inspect_pipeline.messages.errors import MALFORMED
from inspect_pipeline.recording.frames import iter_channel_messages

if TYPE_CHECKING:
    from collections.abc import Iterable

    from inspect_pipeline.geometry.camera import Intrinsics
    from inspect_pipeline.recording.reader import Recording
    from inspect_pipeline.recording.types import CameraChannel


@dataclass(frozen=True, slots=True)
class LensTrack:
    """The lenses of a camera in the order of time, each from its log time on; a zoom changes them."""

    times_ns: list[int] = field(default_factory=list)
    lenses: list[Intrinsics] = field(default_factory=list)

    def add(self, time_ns: int, lens: Intrinsics) -> None:
        """Append a calibration, unless it repeats the last one."""
        if not self.lenses or lens != self.lenses[-1]:
            self.times_ns.append(time_ns)
            self.lenses.append(lens)

    def at(self, time_ns: int) -> Intrinsics:
        """Return the lens in force at a time; before the first calibration, the first."""
        return self.lenses[max(0, bisect_right(self.times_ns, time_ns) - 1)]


def read_lenses(recording: Recording, cameras: Iterable[CameraChannel]) -> dict[int, LensTrack]:
    """Return the lenses of cameras by channel id, without those that are not calibrated.

    As in viewers, a calibration belongs to the camera whose topic has the longest beginning in common with
    its own; one that has nothing in common is used when the recording has a single camera.
    Raises RecordingError when chunks of a `strict` recording cannot be read.
    """
    parsers = {c.channel_id: parser_for(c.schema_name, c.message_encoding) for c in recording.channels}
    known = {channel_id: parser for channel_id, parser in parsers.items() if parser}
    tracks = {channel_id: LensTrack() for channel_id in known}
    for message in iter_channel_messages(recording, known.keys()):
        try:
            lens = known[message.channel_id](message.data)
        except MALFORMED:
            continue
        if lens:
            tracks[message.channel_id].add(message.log_time_ns, lens)
    topics = {c.channel_id: c.topic for c in recording.channels if c.channel_id in known}
    calibrated = {channel_id: topic for channel_id, topic in topics.items() if tracks[channel_id].lenses}
    n_least = 1 if len(recording.camera_channels) > 1 else 0
    found = {}
    for camera in cameras:
        nearest = _nearest(camera.topic, calibrated, n_least)
        if nearest is not None:
            found[camera.channel_id] = tracks[nearest]
    return found


def read_intrinsics(recording: Recording, camera: CameraChannel) -> Intrinsics | None:
    """Return the first calibration of a camera, None when there is none."""
    track = read_lenses(recording, [camera]).get(camera.channel_id)
    return track.lenses[0] if track else None


def _nearest(topic: str, calibrated: dict[int, str], n_least: int) -> int | None:
    """The channel whose topic has most leading parts in common, at least `n_least`; ties by topic."""
    ranked = sorted(calibrated, key=lambda i: (-_n_common_parts(calibrated[i], topic), calibrated[i]))
    return next((i for i in ranked if _n_common_parts(calibrated[i], topic) >= n_least), None)


def _n_common_parts(topic: str, other: str) -> int:
    pairs = zip(topic.strip("/").split("/"), other.strip("/").split("/"), strict=False)
    return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], pairs))
