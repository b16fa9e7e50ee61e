"""Which channels of a recording are colour cameras, each camera once."""

from __future__ import annotations

import re
from collections import Counter
from typing import TYPE_CHECKING, NamedTuple

from inspect_pipeline.images import decode as images
from inspect_pipeline.recording.file import MESSAGE_HEAD, Damage, message_entries, read_extent
from inspect_pipeline.recording.types import CameraChannel

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping

    from inspect_pipeline.recording.file import RecordingFile
    from inspect_pipeline.recording.layout import Layout
    from inspect_pipeline.recording.types import ChannelSummary

# Last parts of a topic that name the form of its images, not the camera.
_FORMS = frozenset({"compressed", "raw", "image", "image_raw", "image_color", "image_compressed"})


class Cameras(NamedTuple):
    """The cameras of a recording, why other topics of images are refused, and which channels hold video."""

    channels: tuple[CameraChannel, ...]
    refusals: Mapping[str, str]
    video_channel_ids: frozenset[int]


def find_cameras(file: RecordingFile, layout: Layout, channels: Iterable[ChannelSummary]) -> Cameras:
    """The channels of colour images that have messages. Of a camera in several forms the fullest topic."""
    pictures, refusals, video_ids = [], {}, set()
    for channel in channels:
        if channel.message_count == 0:
            continue
        first = _first_image(file, layout, channel)
        if first and first.is_video:
            video_ids.add(channel.channel_id)
        if reason := _refusal(channel, first):
            refusals[channel.topic] = reason
        elif is_image(channel):
            pictures.append(channel)
    taken = _one_topic_per_camera(pictures)
    cameras = tuple(to_camera(channel) for channel in pictures if channel.topic in taken)
    return Cameras(cameras, refusals, frozenset(video_ids))


def _one_topic_per_camera(pictures: Iterable[ChannelSummary]) -> Collection[str]:
    counts = Counter[str]()
    for channel in pictures:
        counts[channel.topic] += channel.message_count or 0
    topics: dict[str, str] = {}
    for topic in counts:
        known = topics.setdefault(_camera_name(topic), topic)
        if counts[topic] > counts[known]:
            topics[_camera_name(topic)] = topic
    return topics.values()


def is_image(channel: ChannelSummary) -> bool:
    """Whether the messages of a channel are images that can be read."""
    return images.is_image(channel.schema_name, channel.message_encoding)


def to_camera(channel: ChannelSummary) -> CameraChannel:
    """A channel of images as a camera."""
    return CameraChannel(
        channel_id=channel.channel_id,
        topic=channel.topic,
        schema_name=channel.schema_name,
        message_encoding=channel.message_encoding,
        message_count=channel.message_count,
    )


def _camera_name(topic: str) -> str:
    """The topic without the parts at its end that only say how images are packed."""
    parts = topic.split("/")
    while len(parts) > 1 and parts[-1] in _FORMS:
        parts.pop()
    return "/".join(parts)


def _refusal(channel: ChannelSummary, first: images.ImageMessage | None) -> str | None:
    """Why a channel of images is not processed, by its first one; one that cannot be read is no reason."""
    if not is_image(channel):
        is_alike = re.search(r"(Image|Video)$", channel.schema_name)
        return f"{channel.schema_name} in {channel.message_encoding} is not read" if is_alike else None
    return images.refusal(first, channel.topic) if first else None


def _first_image(file: RecordingFile, layout: Layout, channel: ChannelSummary) -> images.ImageMessage | None:
    """The first message of a channel of images; None when it cannot be read, and of other channels."""
    payload = _first_payload(file, layout, channel.channel_id) if is_image(channel) else None
    if payload is None:
        return None
    try:
        return images.parse(channel.schema_name, channel.message_encoding, payload)
    except images.ImageError:
        return None


def _first_payload(file: RecordingFile, layout: Layout, channel_id: int) -> memoryview | None:
    for extent in layout.extents:
        if extent.channel_ids is not None and channel_id not in extent.channel_ids:
            continue
        try:
            records = read_extent(file, extent)
            entries = message_entries(records, frozenset({channel_id}))
        except Damage:
            continue
        if entries:
            _, start, end = entries[0]
            return memoryview(records)[start + MESSAGE_HEAD.size : end]
    return None
