"""Select the channels of a recording that are colour cameras, each camera once."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, NamedTuple

from inspect_pipeline.images.decode import refusal
from inspect_pipeline.messages import image as image_messages
from inspect_pipeline.messages.image import ImageError, parse
from inspect_pipeline.recording.file import MESSAGE_HEAD, Damage, iter_messages, read_extent
from inspect_pipeline.recording.types import PHOTOGRAPHS, SOURCE_KEY, CameraChannel

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence

    from inspect_pipeline.messages.image import ImageMessage
    from inspect_pipeline.recording.file import Extent
    from inspect_pipeline.recording.part import Part
    from inspect_pipeline.recording.types import ChannelSummary

# Last parts of a topic that name the encoding of its images, not the camera.
_FORMS = frozenset({"compressed", "raw", "image", "image_raw", "image_color", "image_compressed"})
_MAX_SAMPLES = 16  # first messages of a channel that are parsed to see what it holds


class Cameras(NamedTuple):
    """The cameras of a recording, why other topics of images are refused, and which channels hold video."""

    channels: tuple[CameraChannel, ...]
    refusals: Mapping[str, str]
    video_channel_ids: frozenset[int]


def find_cameras(parts: Sequence[Part], channels: Iterable[ChannelSummary]) -> Cameras:
    """Find the channels of colour images that have messages.

    Of a camera that was recorded in several forms the topic with most messages is taken.
    """
    used = [channel for channel in channels if channel.message_count != 0]
    samples = _sample_images(parts, [channel for channel in used if is_image(channel)])
    pictures, refusals, video_ids = [], {}, set()
    for channel in used:
        of_channel = samples.get(channel.channel_id, [])
        if any(image.is_video for image in of_channel):
            video_ids.add(channel.channel_id)
        if reason := _refusal(channel, of_channel):
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
    return image_messages.is_image(channel.schema_name, channel.message_encoding)


def to_camera(channel: ChannelSummary) -> CameraChannel:
    """Return a channel of images as a camera."""
    return CameraChannel(
        channel_id=channel.channel_id,
        topic=channel.topic,
        schema_name=channel.schema_name,
        message_encoding=channel.message_encoding,
        message_count=channel.message_count,
        is_stills=channel.metadata.get(SOURCE_KEY) == PHOTOGRAPHS,
    )


def _camera_name(topic: str) -> str:
    """Return the topic without trailing parts that only name the encoding of its images."""
    parts = topic.split("/")
    while len(parts) > 1 and parts[-1] in _FORMS:
        parts.pop()
    return "/".join(parts)


def _refusal(channel: ChannelSummary, samples: Sequence[ImageMessage]) -> str | None:
    """Say why the images of a channel are not processed; None when one of the samples can be."""
    if not is_image(channel):
        is_alike = image_messages.looks_like_image(channel.schema_name)
        return f"{channel.schema_name} in {channel.message_encoding} is not read" if is_alike else None
    reasons = [refusal(image, channel.topic) for image in samples]
    return reasons[0] if all(reasons) and reasons else None


def _sample_images(
    parts: Sequence[Part], channels: Iterable[ChannelSummary]
) -> Mapping[int, list[ImageMessage]]:
    """Parse some of the first images of each channel, by channel id; those without content are left out.

    A first message may be empty, cut or of another kind than those that follow, so one alone decides nothing.
    Every extent is read at most once, and none for channels that have samples.
    """
    samples: dict[int, list[ImageMessage]] = {}
    missing = {channel.channel_id: channel for channel in channels}
    for part in parts:
        for extent in part.layout.extents:
            ids = extent.channel_ids
            if not missing:
                return samples
            if ids is not None and missing.keys().isdisjoint(part.ids[i] for i in ids if i in part.ids):
                continue
            for channel_id, payload in _first_payloads(part, extent, missing.keys()):
                if image := _parse(missing[channel_id], payload):
                    samples.setdefault(channel_id, []).append(image)
            missing = {i: channel for i, channel in missing.items() if i not in samples}
    return samples


def _first_payloads(part: Part, extent: Extent, channel_ids: Collection[int]) -> list[tuple[int, memoryview]]:
    """Return (channel id, payload) of the first messages in an extent, a few of each channel."""
    try:
        with part.open() as file:
            records = read_extent(file, extent)
        messages = list(iter_messages(records))
    except Damage:
        return []
    counts, found = Counter[int](), []
    for channel_id, start, end in messages:
        i = part.ids.get(channel_id)
        if i is not None and i in channel_ids and counts[i] < _MAX_SAMPLES:
            counts[i] += 1
            found.append((i, memoryview(records)[start + MESSAGE_HEAD.size : end]))
    return found


def _parse(channel: ChannelSummary, payload: memoryview) -> ImageMessage | None:
    """Parse an image; None when it is malformed or has no content."""
    try:
        image = parse(channel.schema_name, channel.message_encoding, payload)
    except ImageError:
        return None
    return image if image.data else None
