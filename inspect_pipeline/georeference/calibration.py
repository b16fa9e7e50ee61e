"""The calibrations of each camera of a recording, over time."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from inspect_pipeline.messages.calibration import parser_for
from inspect_pipeline.messages.errors import MALFORMED
from inspect_pipeline.recording.cameras import is_image
from inspect_pipeline.recording.types import NOMINAL, SOURCE_KEY

if TYPE_CHECKING:
    from collections.abc import Set as AbstractSet

    from inspect_pipeline.geometry.camera import Intrinsics
    from inspect_pipeline.recording.merge import Message
    from inspect_pipeline.recording.reader import Recording


@dataclass(frozen=True, slots=True)
class LensTrack:
    """The lenses of a camera in the order of time, each from its log time on; a zoom changes them.

    is_nominal: they are as the maker states them, and were not measured.
    """

    times_ns: list[int] = field(default_factory=list)
    lenses: list[Intrinsics] = field(default_factory=list)
    is_nominal: bool = False

    def add(self, time_ns: int, lens: Intrinsics) -> None:
        """Append a calibration, unless it repeats the last one."""
        if not self.lenses or lens != self.lenses[-1]:
            self.times_ns.append(time_ns)
            self.lenses.append(lens)

    def at(self, time_ns: int) -> Intrinsics:
        """Return the lens that is valid at a time; before the first calibration, the first."""
        return self.lenses[max(0, bisect_right(self.times_ns, time_ns) - 1)]


class LensReader:
    """Collects the calibrations of all cameras of a recording, while its messages are read once."""

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        parsers = {c.channel_id: parser_for(c.schema_name, c.message_encoding) for c in recording.channels}
        self._parsers = {channel_id: parser for channel_id, parser in parsers.items() if parser}
        self._tracks = {
            c.channel_id: LensTrack(is_nominal=c.metadata.get(SOURCE_KEY) == NOMINAL)
            for c in recording.channels
            if c.channel_id in self._parsers
        }

    @property
    def channel_ids(self) -> AbstractSet[int]:
        """The ids of the channels with calibrations."""
        return self._parsers.keys()

    def add(self, message: Message) -> None:
        """Add a calibration; one that cannot be parsed is skipped."""
        try:
            lens = self._parsers[message.channel_id](message.data)
        except MALFORMED:
            return
        if lens:
            self._tracks[message.channel_id].add(message.log_time_ns, lens)

    def lenses(self) -> dict[int, LensTrack]:
        """Return the lenses by channel id of the cameras, without those that are not calibrated.

        As in viewers, a calibration belongs to the camera whose topic has the longest beginning in common
        with its own; one that has nothing in common is used when the recording has a single camera.
        """
        channels = self._recording.channels
        topics = [(c.topic, c.channel_id) for c in channels if c.channel_id in self._tracks]
        calibrated: dict[tuple[str, ...], LensTrack] = {}
        for topic, channel_id in sorted(topics):
            if self._tracks[channel_id].lenses:
                for beginning in _beginnings(topic):
                    calibrated.setdefault(beginning, self._tracks[channel_id])
        if len(self._recording.camera_channels) > 1:
            calibrated.pop((), None)
        nearest = {
            c.channel_id: next((calibrated[b] for b in _beginnings(c.topic) if b in calibrated), None)
            for c in channels
            if is_image(c)
        }
        return {channel_id: track for channel_id, track in nearest.items() if track}


def _beginnings(topic: str) -> list[tuple[str, ...]]:
    """Return the prefixes of a topic that end at a slash, the longest first and the empty one last."""
    parts = tuple(topic.strip("/").split("/"))
    return [parts[:n] for n in range(len(parts), -1, -1)]
