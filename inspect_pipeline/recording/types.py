"""Channels and frames of a recording."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

    from inspect_pipeline.arrays import ImageArray


# In the metadata of an image channel: what `pack` made it of. Photographs are marked, because their times may
# be whole seconds and their pauses and turns are meant.
SOURCE_KEY, PHOTOGRAPHS, NOMINAL = "lsnet_pipe.source", "photographs", "nominal lens"


@dataclass(frozen=True, slots=True)
class ChannelSummary:
    """A channel of a recording. `message_count` is None when neither statistics nor indexes say.

    metadata: the key and value pairs of its Channel record.
    """

    channel_id: int
    topic: str
    schema_name: str
    schema_encoding: str
    message_encoding: str
    message_count: int | None
    metadata: Mapping[str, str] = field(default_factory=dict, hash=False)


@dataclass(frozen=True, slots=True)
class CameraChannel:
    """A channel of a recording whose messages are colour images."""

    channel_id: int
    topic: str
    schema_name: str
    message_encoding: str
    message_count: int | None  # None when the recording has no statistics
    is_stills: bool = False  # photographs: no video, and their times may be whole seconds


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One image message of a camera channel.

    frame_idx counts every image message of the channel in log-time order, ties by file offset.
    stamp_ns is the image's own header stamp, log_time_ns and publish_time_ns are the message's.
    image is uint8 (height, width, 3) RGB, or None with the reason in `error`. `doubt` is what is probably
    wrong with an image that was decoded, such as damage that its decoder noticed.
    """

    channel_id: int
    topic: str
    frame_idx: int
    log_time_ns: int
    publish_time_ns: int
    stamp_ns: int
    frame_id: str
    image: ImageArray | None
    error: str | None = None
    doubt: str | None = None
