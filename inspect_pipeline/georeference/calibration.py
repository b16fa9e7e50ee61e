"""The calibration of each camera of a recording."""

from __future__ import annotations

from itertools import takewhile
from typing import TYPE_CHECKING

from inspect_pipeline.messages.calibration import parser_for
from inspect_pipeline.messages.errors import MALFORMED
from inspect_pipeline.recording.frames import iter_channel_messages

if TYPE_CHECKING:
    from inspect_pipeline.geometry.camera import Intrinsics
    from inspect_pipeline.messages.calibration import Parser
    from inspect_pipeline.recording.reader import Recording
    from inspect_pipeline.recording.types import CameraChannel


def read_intrinsics(recording: Recording, camera: CameraChannel) -> Intrinsics | None:
    """Return the first calibration of a camera, None when there is none.

    As in viewers, it is looked for on the topic that has the longest beginning in common with the camera's;
    one that has nothing in common is used when the recording has a single camera.
    Raises RecordingError when chunks cannot be read of a `strict` recording.
    """
    parsers = {c: parser_for(c.schema_name, c.message_encoding) for c in recording.channels}
    channels = {channel: parser for channel, parser in parsers.items() if parser}
    n_least = 1 if len(recording.camera_channels) > 1 else 0
    common = {channel: _n_common_parts(channel.topic, camera.topic) for channel in channels}
    for channel in sorted(channels, key=lambda channel: (-common[channel], channel.topic)):
        if common[channel] >= n_least:
            found = _read_first(recording, channel.channel_id, channels[channel])
            if found:
                return found
    return None


def _n_common_parts(topic: str, other: str) -> int:
    pairs = zip(topic.strip("/").split("/"), other.strip("/").split("/"), strict=False)
    return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], pairs))


def _read_first(recording: Recording, channel_id: int, parse: Parser) -> Intrinsics | None:
    for message in iter_channel_messages(recording, {channel_id}):
        try:
            found = parse(message.data)
        except MALFORMED:
            continue
        if found:
            return found
    return None
