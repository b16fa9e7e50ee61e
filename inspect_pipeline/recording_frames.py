"""Camera frames of a recording, and messages of other channels, in log-time order."""

from __future__ import annotations

from collections import Counter
from contextlib import suppress
from typing import TYPE_CHECKING

from inspect_pipeline import images
from inspect_pipeline.errors import RecordingError
from inspect_pipeline.recording_extents import STRICT_REMEDY, Damage, reading
from inspect_pipeline.recording_layout import count_messages
from inspect_pipeline.recording_merge import Message, iter_messages
from inspect_pipeline.types import Frame
from inspect_pipeline.video import VideoDecoder

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator

    import numpy as np
    from numpy.typing import NDArray

    from inspect_pipeline.recording import Recording
    from inspect_pipeline.recording_extents import Extent, RecordingFile
    from inspect_pipeline.types import CameraChannel

_NEVER_NS = 1 << 64  # beyond every log time
_MAX_TIME_NS = (1 << 63) - 1  # the year 2262; later ones are damage, and databases do not hold them


def iter_frames(
    recording: Recording,
    topics: Collection[str] | None = None,
    every: int = 1,
    start_ns: int | None = None,
    end_ns: int | None = None,
) -> Iterator[Frame]:
    """The camera frames with start_ns <= log time < end_ns in log-time order, ties by position in the file.

    frame_idx counts every image message of a channel, and only frames whose frame_idx is a multiple of
    `every` are decoded, of a video also those they stand on. Raises RecordingError: at the call when there
    is no such camera, while iterating when nothing can be read, or anything is lost of a `strict` recording.
    """
    cameras = recording.select_cameras(topics)
    return _iter_frames(recording, cameras, every, start_ns, end_ns)


def _iter_frames(
    recording: Recording,
    cameras: tuple[CameraChannel, ...],
    every: int,
    start_ns: int | None,
    end_ns: int | None,
) -> Iterator[Frame]:
    by_id = {camera.channel_id: camera for camera in cameras}
    losses = _Losses(recording)
    first_ns, last_ns = start_ns or 0, _NEVER_NS if end_ns is None else end_ns
    with reading(recording.path) as file:
        extents = [
            e for e in recording.layout.extents if e.channel_ids is None or e.channel_ids & by_id.keys()
        ]
        videos = {i: VideoDecoder() for i in by_id.keys() & recording.video_channel_ids}
        read_ns = 0 if videos else first_ns  # a video may begin long before its picture at `start_ns`
        n_seen = _count_before(file, extents, read_ns, losses)
        overlapping = [e for e in extents if e.end_ns >= read_ns and e.start_ns < last_ns]
        for message in iter_messages(file, overlapping, frozenset(by_id), losses.add):
            camera, video = by_id[message.channel_id], videos.get(message.channel_id)
            frame_idx = n_seen[message.channel_id]
            n_seen[message.channel_id] += 1
            if first_ns <= message.log_time_ns < last_ns and frame_idx % every == 0:
                yield _to_frame(camera, frame_idx, message, video.decode if video else images.decode)
            elif video:
                with suppress(images.ImageError):
                    video.pass_over(_parse(camera, message))
    if losses.n_extents and losses.n_extents == len(extents):
        raise RecordingError(recording.path, recording.losses[-1], "not one image can be read, copy it again")


def iter_channel_messages(recording: Recording, channel_ids: Collection[int]) -> Iterator[Message]:
    """The messages of some channels in log-time order.

    Raises RecordingError when anything is lost of a `strict` recording.
    """
    wanted = frozenset(channel_ids)
    if not wanted:
        return
    extents = [e for e in recording.layout.extents if e.channel_ids is None or e.channel_ids & wanted]
    with reading(recording.path) as file:
        yield from iter_messages(file, extents, wanted, _Losses(recording).add)


class _Losses:
    """Extents that cannot be read: noted in the recording, or refused when it is strict."""

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self.n_extents = 0

    def add(self, extent: Extent, damage: Damage) -> None:
        self.n_extents += 1
        loss = f"{damage} at byte {extent.offset:,}"
        if self._recording.strict:
            raise RecordingError(self._recording.path, loss, STRICT_REMEDY)
        if loss not in self._recording.losses:
            self._recording.losses.append(loss)


def _count_before(
    file: RecordingFile, extents: Iterable[Extent], start_ns: int, losses: _Losses
) -> Counter[int]:
    """Messages per channel in the extents that end before `start_ns`."""
    counts = Counter[int]()
    for extent in extents:
        if extent.end_ns < start_ns:
            try:
                counts += count_messages(file, extent)
            except Damage as damage:
                losses.add(extent, damage)
    return counts


def _parse(camera: CameraChannel, message: Message) -> images.ImageMessage:
    return images.parse(camera.schema_name, camera.message_encoding, message.data)


def _to_frame(
    camera: CameraChannel,
    frame_idx: int,
    message: Message,
    decode: Callable[[images.ImageMessage], NDArray[np.uint8]],
) -> Frame:
    stamp_ns, frame_id, image, error = message.log_time_ns, "", None, None
    try:
        parsed = _parse(camera, message)
        stamp_ns, frame_id = parsed.stamp_ns, parsed.frame_id
        image = decode(parsed)
    except images.ImageError as reason:
        error = str(reason)
    return Frame(
        channel_id=camera.channel_id,
        topic=camera.topic,
        frame_idx=frame_idx,
        log_time_ns=min(message.log_time_ns, _MAX_TIME_NS),
        publish_time_ns=message.publish_time_ns,
        stamp_ns=stamp_ns,
        frame_id=frame_id,
        image=image,
        error=error,
    )
