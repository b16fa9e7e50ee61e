"""The records that travel along the one path: channels, frames, and what was made of a recording."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from pathlib import Path

    from inspect_pipeline.arrays import ImageArray


WriteMode = Literal["copy", "sidecar", "none"]  # where annotations go
SchemaName = Literal["protobuf", "ros2msg"]  # of annotations
ExecutorName = Literal["local", "ray"]  # where a batch has its workers


@dataclass(frozen=True, slots=True)
class ChannelSummary:
    """A channel of a recording. `message_count` is None where neither statistics nor indexes tell."""

    channel_id: int
    topic: str
    schema_name: str
    schema_encoding: str
    message_encoding: str
    message_count: int | None


@dataclass(frozen=True, slots=True)
class CameraChannel:
    """A channel of a recording whose messages are colour images."""

    channel_id: int
    topic: str
    schema_name: str
    message_encoding: str
    message_count: int | None  # None when the recording has no statistics


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One image message of a camera channel.

    frame_idx counts every image message of the channel in log-time order, ties by file offset.
    stamp_ns is the image's own header stamp, log_time_ns and publish_time_ns are the message's.
    image is uint8 (height, width, 3) RGB, or None with the reason in `error`.
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


@dataclass(frozen=True, slots=True)
class ProcessResult:
    """What `process` did with one recording; the fields are those of `process --json`.

    reason: what was lost of a recovered one, or that it is an annotated copy; warnings: what is odd about it.
    """

    flight_id: str
    source: str
    status: Literal["ok", "skipped", "recovered"]
    annotated: Path | None
    n_frames: int
    n_bad_frames: int
    n_segments: int
    seconds: float
    reason: str | None = None
    warnings: tuple[str, ...] = ()
