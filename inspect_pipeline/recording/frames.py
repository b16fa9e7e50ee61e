"""Camera frames of a recording, and messages of other channels, in log-time order."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator
from functools import partial
from itertools import islice
from typing import TYPE_CHECKING, Generic, TypeVar

from inspect_pipeline.errors import RecordingError
from inspect_pipeline.images.decode import ImageDecoder
from inspect_pipeline.images.video import VideoDecoder, VideoPicture
from inspect_pipeline.messages.image import ImageError, ImageMessage, parse
from inspect_pipeline.recording.file import Damage
from inspect_pipeline.recording.log_times import FrameChecks
from inspect_pipeline.recording.merge import Message, PartExtent, merge_messages
from inspect_pipeline.recording.part import count_messages
from inspect_pipeline.recording.types import Frame

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Sequence

    from inspect_pipeline.recording.reader import Recording
    from inspect_pipeline.recording.types import CameraChannel

_T = TypeVar("_T")
_S = TypeVar("_S")
_MAX_WAITING_BYTES = 64 << 20  # of messages behind a picture that does not come out of its video
_MAX_FIRST_IMAGES = 64  # of a camera, in which the range of its values is looked for
_NEVER_NS = 1 << 64  # after every log time
_MAX_TIME_NS = (1 << 63) - 1  # the year 2262; later ones are damage, and databases do not hold them


class RecordingIterator(Iterator[_T], Generic[_T]):
    """Iterates over frames or messages of a recording.

    losses: one phrase for each stretch that could not be read so far.
    warnings: what is unusual about the times of the frames so far, one phrase each.
    """

    def __init__(self, items: Iterator[_T], losses: Losses, checks: FrameChecks | None = None) -> None:
        self._items, self._losses, self._checks = items, losses, checks

    def __next__(self) -> _T:
        return next(self._items)

    def map(self, function: Callable[[_T], _S]) -> RecordingIterator[_S]:
        """Return an iterator over what a function makes of each item."""
        return RecordingIterator(map(function, self), self._losses, self._checks)

    @property
    def losses(self) -> tuple[str, ...]:
        return tuple(self._losses.phrases)

    @property
    def warnings(self) -> tuple[str, ...]:
        return tuple(self._checks.warnings()) if self._checks else ()


def iter_frames(
    recording: Recording,
    cameras: Sequence[CameraChannel] | None = None,
    *,
    every: int = 1,
    start_ns: int | None = None,
    end_ns: int | None = None,
) -> RecordingIterator[Frame]:
    """Iterate over camera frames in log-time order, ties by position in the file.

    Frames whose log times are outliers, such as 0, are set aside: counted in frame_idx and in the warnings.

    Args:
        recording: where to read.
        cameras: whose frames, of `recording.select_cameras`; all colour cameras by default.
        every: decode only frames whose frame_idx, which counts every image message of a channel, is a
            multiple of this; of a video also those that they depend on.
        start_ns: only frames with start_ns <= log time.
        end_ns: only frames with log time < end_ns.

    Raises:
        RecordingError: at the call when there is no camera; while iterating when nothing can be read, or
            anything is lost of a `strict` recording.
    """
    frames = iter_undecoded(recording, cameras, every=every, start_ns=start_ns, end_ns=end_ns)
    return frames.map(UndecodedFrame.decode)


def iter_undecoded(
    recording: Recording,
    cameras: Sequence[CameraChannel] | None = None,
    *,
    every: int = 1,
    start_ns: int | None = None,
    end_ns: int | None = None,
) -> RecordingIterator[UndecodedFrame]:
    """Iterate over the same frames as `iter_frames`, each to be decoded in any thread."""
    if cameras is None:
        cameras = recording.select_cameras()
    losses, checks = Losses(recording), FrameChecks()
    frames = _iter_undecoded(
        recording, cameras, losses, checks, every=every, start_ns=start_ns, end_ns=end_ns
    )
    return RecordingIterator(checks.checked(frames), losses, checks)


def _iter_undecoded(
    recording: Recording,
    cameras: Sequence[CameraChannel],
    losses: Losses,
    checks: FrameChecks,
    *,
    every: int,
    start_ns: int | None,
    end_ns: int | None,
) -> Iterator[UndecodedFrame]:
    by_id = {camera.channel_id: camera for camera in cameras}
    first_ns, last_ns = start_ns or 0, _NEVER_NS if end_ns is None else end_ns
    extents = recording.extents(by_id)
    videos = {i: VideoDecoder() for i in by_id.keys() & recording.video_channel_ids}
    read_ns = 0 if videos else first_ns  # a video may begin long before its picture at `start_ns`
    n_seen, usual = _count_before(extents, read_ns, losses), recording.usual_times(cameras)
    overlapping = [e for e in extents if e.extent.end_ns >= read_ns and e.extent.start_ns < last_ns]
    stills = {i: ImageDecoder(partial(_first_images, recording, camera)) for i, camera in by_id.items()}
    waiting = _Queue()
    for message in merge_messages(overlapping, frozenset(by_id), losses.add):
        frame_idx = n_seen[message.channel_id]
        n_seen[message.channel_id] += 1
        is_wanted = first_ns <= message.log_time_ns < last_ns and frame_idx % every == 0
        if is_wanted and message.log_time_ns not in usual:
            is_wanted = False
            checks.set_aside(by_id[message.channel_id].topic)
        if is_wanted or message.channel_id in videos:
            frame = UndecodedFrame(by_id[message.channel_id], frame_idx, message, stills, videos)
            waiting.add(frame, is_wanted=is_wanted)
        yield from waiting.settled()
    for video in videos.values():
        video.finish()
    yield from waiting.settled()
    if losses.n_extents and losses.n_extents == len(extents):
        raise RecordingError(recording.path, losses.phrases[-1], "not one image can be read, copy it again")


def iter_channel_messages(
    recording: Recording, channel_ids: Collection[int], *, start_ns: int = 0, end_ns: int = _NEVER_NS
) -> RecordingIterator[Message]:
    """Iterate over the messages of some channels with start_ns <= log time < end_ns, in log-time order.

    Raises RecordingError when anything is lost of a `strict` recording.
    """
    losses = Losses(recording)
    extents = recording.extents(channel_ids) if channel_ids else []
    overlapping = [e for e in extents if e.extent.end_ns >= start_ns and e.extent.start_ns < end_ns]
    messages = merge_messages(overlapping, frozenset(channel_ids), losses.add)
    return RecordingIterator((m for m in messages if start_ns <= m.log_time_ns < end_ns), losses)


def _first_images(recording: Recording, camera: CameraChannel) -> Iterator[ImageMessage]:
    """Iterate over the first images of a camera; those that are malformed are skipped."""
    messages = iter_channel_messages(recording, {camera.channel_id})
    for message in islice(messages, _MAX_FIRST_IMAGES):
        try:
            yield parse(camera.schema_name, camera.message_encoding, message.data)
        except ImageError:
            continue


class Losses:
    """Collects the extents that cannot be read; raises RecordingError for those of a strict recording."""

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self.n_extents = 0
        self.phrases: list[str] = []

    def add(self, extent: PartExtent, damage: Damage) -> None:
        """Add an extent."""
        self.n_extents += 1
        offset = extent.part.start + extent.extent.offset
        self.phrases.append(self._recording.loss_in(extent.part, f"{damage} at byte {offset:,}"))


def _count_before(extents: Iterable[PartExtent], start_ns: int, losses: Losses) -> Counter[int]:
    """Count messages per channel in the extents that end before `start_ns`."""
    counts = Counter[int]()
    for each in extents:
        if each.extent.end_ns < start_ns:
            try:
                with each.part.open() as file:
                    found = count_messages(file, each.extent)
            except Damage as damage:
                losses.add(each, damage)
            else:
                counts.update({each.part.ids[i]: n for i, n in found.items() if i in each.part.ids})
    return counts


class UndecodedFrame:
    """A frame whose picture is not decoded yet; a video may give it later."""

    def __init__(
        self,
        camera: CameraChannel,
        frame_idx: int,
        message: Message,
        stills: dict[int, ImageDecoder],
        videos: dict[int, VideoDecoder],
    ) -> None:
        self._camera, self._frame_idx, self._message = camera, frame_idx, message
        self._parsed: ImageMessage | None = None
        self._error: str | None = None
        self._still = stills[camera.channel_id]
        self._video: VideoDecoder | None = None
        self._picture: VideoPicture | None = None
        self.topic = camera.topic
        self.log_time_ns = min(message.log_time_ns, _MAX_TIME_NS)
        try:
            self._parsed = parse(camera.schema_name, camera.message_encoding, message.data)
        except ImageError as reason:
            self._error = str(reason)
        # A message that is a picture by its first bytes does not belong to the video of its channel.
        if self._parsed and self._parsed.is_video and self._parsed.data:
            self._video = videos.setdefault(camera.channel_id, VideoDecoder())

    @property
    def stamp_ns(self) -> int:
        """The image's own header stamp, or the log time of a malformed message."""
        return self._parsed.stamp_ns if self._parsed else self.log_time_ns

    @property
    def n_bytes(self) -> int:
        """Size of the message."""
        return len(self._message.data)

    def add_to_video(self, *, is_wanted: bool) -> None:
        """Pass the message to the decoder of its video, if it belongs to one."""
        if self._video and self._parsed:
            self._video.add(self._frame_idx, self._parsed, is_wanted=is_wanted)

    def is_settled(self) -> bool:
        """Whether the picture, or that there is none, is known."""
        return self._video is None or self._video.is_settled(self._frame_idx)

    def settle(self) -> None:
        """Take the picture out of its video, which the thread that reads the recording must do."""
        if self._video:
            self._picture = self._video.take(self._frame_idx)

    def decode(self) -> Frame:
        """Return the frame, with its picture or the reason why there is none."""
        image, error, doubt = None, self._error, None
        if self._parsed:
            try:
                if self._picture:
                    image = self._picture.to_rgb()
                else:
                    image, doubt = self._still.decode(self._parsed)
            except ImageError as reason:
                error = str(reason)
        return Frame(
            channel_id=self._camera.channel_id,
            topic=self.topic,
            frame_idx=self._frame_idx,
            log_time_ns=self.log_time_ns,
            publish_time_ns=self._message.publish_time_ns,
            stamp_ns=self.stamp_ns,
            frame_id=self._parsed.frame_id if self._parsed else "",
            image=image,
            error=error,
            doubt=doubt,
        )


class _Queue:
    """Frames in order; those of videos wait for their pictures. Bounded in bytes."""

    def __init__(self) -> None:
        self._frames: deque[UndecodedFrame] = deque()
        self._n_bytes = 0

    def add(self, frame: UndecodedFrame, *, is_wanted: bool) -> None:
        """Add a frame behind the others; one that is not wanted only goes into its video."""
        frame.add_to_video(is_wanted=is_wanted)
        if is_wanted:
            self._frames.append(frame)
            self._n_bytes += frame.n_bytes

    def settled(self) -> Iterator[UndecodedFrame]:
        """Take the frames from the front whose pictures are known, or that have waited too long."""
        while self._frames and (self._frames[0].is_settled() or self._n_bytes > _MAX_WAITING_BYTES):
            frame = self._frames.popleft()
            self._n_bytes -= frame.n_bytes
            frame.settle()
            yield frame
