"""Camera frames of a recording, and messages of other channels, in log-time order."""

from __future__ import annotations

from collections import Counter, deque
from typing import TYPE_CHECKING

from inspect_pipeline.errors import RecordingError
from inspect_pipeline.images import decode as images
from inspect_pipeline.images.video import VideoDecoder
from inspect_pipeline.recording.file import STRICT_REMEDY, Damage, reading
from inspect_pipeline.recording.layout import count_messages
from inspect_pipeline.recording.merge import Message, iter_messages
from inspect_pipeline.recording.types import Frame

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator

    from inspect_pipeline.recording.file import Extent, RecordingFile
    from inspect_pipeline.recording.reader import Recording
    from inspect_pipeline.recording.types import CameraChannel

_MAX_WAITING_BYTES = 64 << 20  # of messages behind a picture that does not come out of its video
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
        waiting = _Queue()
        for message in iter_messages(file, overlapping, frozenset(by_id), losses.add):
            camera, video = by_id[message.channel_id], videos.get(message.channel_id)
            frame_idx = n_seen[message.channel_id]
            n_seen[message.channel_id] += 1
            is_wanted = first_ns <= message.log_time_ns < last_ns and frame_idx % every == 0
            if is_wanted or video:
                frame = _Waiting(camera, frame_idx, message, video)
                waiting.add(frame, is_wanted=is_wanted)
            yield from waiting.settled()
        for video in videos.values():
            video.finish()
        yield from waiting.settled()
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


class _Waiting:
    """A frame whose picture is decoded when its turn comes; one of a video may come out of it later."""

    def __init__(
        self, camera: CameraChannel, frame_idx: int, message: Message, video: VideoDecoder | None
    ) -> None:
        self._camera, self._frame_idx, self._message = camera, frame_idx, message
        self._parsed: images.ImageMessage | None = None
        self._error: str | None = None
        try:
            self._parsed = images.parse(camera.schema_name, camera.message_encoding, message.data)
        except images.ImageError as reason:
            self._error = str(reason)
        # What says by its first bytes that it is a picture is none of the video.
        self._video = video if self._parsed and self._parsed.is_video else None

    @property
    def n_bytes(self) -> int:
        """Size of the message."""
        return len(self._message.data)

    def add_to_video(self, *, is_wanted: bool) -> None:
        """Let the video have the message."""
        if self._video and self._parsed:
            self._video.add(self._frame_idx, self._parsed, is_wanted=is_wanted)

    def is_settled(self) -> bool:
        """Whether the picture can be had."""
        return self._video is None or self._video.is_settled(self._frame_idx)

    def to_frame(self) -> Frame:
        """The frame, with its picture or the reason why there is none."""
        parsed, image, error = self._parsed, None, self._error
        if parsed:
            try:
                image = self._video.take(self._frame_idx) if self._video else images.decode(parsed)
            except images.ImageError as reason:
                error = str(reason)
        log_time_ns = min(self._message.log_time_ns, _MAX_TIME_NS)
        return Frame(
            channel_id=self._camera.channel_id,
            topic=self._camera.topic,
            frame_idx=self._frame_idx,
            log_time_ns=log_time_ns,
            publish_time_ns=self._message.publish_time_ns,
            stamp_ns=parsed.stamp_ns if parsed else log_time_ns,
            frame_id=parsed.frame_id if parsed else "",
            image=image,
            error=error,
        )


class _Queue:
    """Frames in their order, those of videos held until their pictures have come out; bounded in bytes."""

    def __init__(self) -> None:
        self._frames: deque[_Waiting] = deque()
        self._n_bytes = 0

    def add(self, frame: _Waiting, *, is_wanted: bool) -> None:
        frame.add_to_video(is_wanted=is_wanted)
        if is_wanted:
            self._frames.append(frame)
            self._n_bytes += frame.n_bytes

    def settled(self) -> Iterator[Frame]:
        """Take the frames from the front whose pictures can be had, or that have waited too long."""
        while self._frames and (self._frames[0].is_settled() or self._n_bytes > _MAX_WAITING_BYTES):
            frame = self._frames.popleft()
            self._n_bytes -= frame.n_bytes
            yield frame.to_frame()
