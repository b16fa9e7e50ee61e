"""Recordings: what an MCAP file holds. Its frames are read by `recording_frames`.

    open_recording(path) -> Recording        what is in it

Times are integer nanoseconds, ranges are start <= t < end. What cannot be read is lost with a phrase in
`Recording.losses`, or refused when the recording was opened with `strict`.
"""

from __future__ import annotations

import hashlib
import zlib
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, TypeVar

from mcap.records import Attachment, Metadata

from inspect_pipeline.errors import RecordingError
from inspect_pipeline.recording.cameras import find_cameras, is_image, to_camera
from inspect_pipeline.recording.file import STRICT_REMEDY, Damage, RecordingFile, reading
from inspect_pipeline.recording.layout import Layout, count_messages, read_layout
from inspect_pipeline.recording.summary import load_record
from inspect_pipeline.recording.types import ChannelSummary

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator, Mapping
    from pathlib import Path

    from mcap.records import AttachmentIndex, MetadataIndex

    from inspect_pipeline.recording.types import CameraChannel

_DIGEST_BYTES = 1 << 20
_PLAUSIBLE_S = (946_684_800, 4_102_444_800)  # the years 2000 to 2100
_WRONG_UNITS = {"seconds": 1, "milliseconds": 10**3, "microseconds": 10**6}
_YEAR_NS = 365 * 86_400 * 10**9
_R = TypeVar("_R", Attachment, Metadata)
RUN_METADATA = "lsnet_pipe.run"  # name of the Metadata record that marks an annotated copy


@dataclass(frozen=True, eq=False)
class Recording:
    """What an MCAP file holds.

    start_ns, end_ns: first and last log time, both 0 without messages.
    camera_channels: the colour cameras, each once, in the order of their topics.
    refusals: topics of images that are no cameras, and why.
    video_channel_ids: channels whose images are pieces of a video.
    metadata: the Metadata records by name.
    losses: one phrase per part that cannot be read; grows while frames are read.
    layout: where the records lie, for those who append to the file.
    made_of: the flight_id of what the file was made from, None when it is itself what was recorded.
    """

    path: Path
    size_bytes: int
    strict: bool
    profile: str
    start_ns: int
    end_ns: int
    channels: tuple[ChannelSummary, ...]
    camera_channels: tuple[CameraChannel, ...]
    refusals: Mapping[str, str]
    video_channel_ids: frozenset[int]
    metadata: Mapping[str, Mapping[str, str]]
    layout: Layout
    made_of: str | None = None

    @property
    def losses(self) -> list[str]:
        """One phrase per part that cannot be read, in the order they were met."""
        return self.layout.losses

    @property
    def warnings(self) -> list[str]:
        """What is odd about the log times but prevents nothing, one phrase each."""
        found = [
            f"its log times look like {unit} instead of nanoseconds"
            for unit, factor in _WRONG_UNITS.items()
            if _PLAUSIBLE_S[0] <= self.start_ns / factor <= self.end_ns / factor < _PLAUSIBLE_S[1]
        ]
        years = (self.end_ns - self.start_ns) / _YEAR_NS
        if years > 1:
            found.append(f"its log times span {years:.0f} years")
        starts = [e.start_ns for e in self.layout.extents if e.channel_ids is None or e.channel_ids]
        n_early = sum(after < before for before, after in pairwise(starts))
        if n_early:
            found.append(f"its messages are out of order: {n_early:,} stretches begin before the one ahead")
        return found

    @property
    def is_annotated_copy(self) -> bool:
        """Whether this program wrote annotations into the file."""
        return RUN_METADATA in self.metadata

    @cached_property
    def flight_id(self) -> str:
        """SHA-256 of the content in hex; of a file made from others, that of the flight it belongs to.

        Reads the whole file once, and checks the CRC of the data section on the way where the file states
        one. Raises RecordingError.
        """
        named = self.made_of or self.metadata.get(RUN_METADATA, {}).get("flight_id")
        if named:
            return named
        with reading(self.path) as file:
            sha256, data_crc = _digest(file, self.layout.data_end if self.layout.data_crc else 0)
        if data_crc != self.layout.data_crc:
            self._lose("its data section does not match its CRC")
        return sha256

    def _lose(self, loss: str) -> None:
        if self.strict:
            raise RecordingError(self.path, loss, STRICT_REMEDY)
        if loss not in self.losses:
            self.losses.append(loss)

    def select_cameras(self, topics: Collection[str] | None = None) -> tuple[CameraChannel, ...]:
        """The cameras of `topics`, or all colour cameras. Raises RecordingError when there is none."""
        if topics is None:
            if not self.camera_channels:
                where = " in the part that can be read" if self.losses else ""
                raise RecordingError(self.path, f"no camera topic{where}", self._what_it_has())
            return self.camera_channels
        images_by_topic = {c.topic: c for c in self.channels if is_image(c)}
        for topic in topics:
            if topic not in images_by_topic:
                known = ", ".join(sorted(images_by_topic)) or "none"
                raise RecordingError(self.path, f"no images on topic {topic}", f"its image topics: {known}")
        return tuple(to_camera(c) for c in self.channels if c.topic in topics and is_image(c))

    def _what_it_has(self) -> str:
        """What a recording without a camera has instead: refused topics of images and why, or others."""
        if self.refusals:
            return "; ".join(f"{topic}: {reason}" for topic, reason in self.refusals.items())
        topics = [channel.topic for channel in self.channels[:5]]
        return f"its topics: {', '.join(topics) or 'none'}"

    def schema_data(self, channel_id: int) -> bytes:
        """The schema of a channel as the file has it; empty when it has none."""
        schema = self.layout.schemas.get(self.layout.channels[channel_id].schema_id)
        return schema.data if schema else b""

    def iter_attachments(self) -> Iterator[Attachment]:
        """The Attachment records; one that cannot be read is lost. Raises RecordingError."""
        return self._iter_records(Attachment, self.layout.attachments)

    def iter_metadata(self) -> Iterator[Metadata]:
        """The Metadata records, in their order; one that cannot be read is lost. Raises RecordingError."""
        return self._iter_records(Metadata, self.layout.metadata)

    def _iter_records(
        self, kind: type[_R], indexes: Iterable[AttachmentIndex | MetadataIndex]
    ) -> Iterator[_R]:
        with reading(self.path) as file:
            for index in indexes:
                try:
                    yield load_record(file, kind, index.offset)
                except Damage as damage:
                    self._lose(f"{damage} at byte {index.offset:,}")

    def message_counts(self) -> Counter[int]:
        """Messages per channel id, read from the chunks where nothing else tells. Raises RecordingError."""
        if self.layout.statistics is not None:
            return Counter(self.layout.statistics.channel_message_counts)
        with reading(self.path) as file:
            return _count_all(file, self.layout)


def open_recording(path: Path, *, strict: bool = False, made_of: str | None = None) -> Recording:
    """Look into an MCAP file. Raises RecordingError when it is none, or damaged and `strict`."""
    with reading(path) as file:
        layout = read_layout(file)
        channels = _channel_summaries(file, layout)
        cameras = find_cameras(file, layout, channels)
        extents = [e for e in layout.extents if e.channel_ids is None or e.channel_ids]
        recording = Recording(
            path=path,
            size_bytes=file.size_bytes,
            strict=strict,
            profile=layout.header.profile,
            start_ns=min((e.start_ns for e in extents), default=0),
            end_ns=max((e.end_ns for e in extents), default=0),
            channels=channels,
            camera_channels=cameras.channels,
            refusals=cameras.refusals,
            video_channel_ids=cameras.video_channel_ids,
            metadata=_read_metadata(file, layout),
            layout=layout,
            made_of=made_of,
        )
    if strict and layout.losses:
        raise RecordingError(path, layout.losses[0], STRICT_REMEDY)
    return recording


def _digest(file: RecordingFile, n_crc_bytes: int) -> tuple[str, int]:
    """(SHA-256 of a file in hex, CRC-32 of its first `n_crc_bytes`)."""
    sha256, crc = hashlib.sha256(), 0
    for offset in range(0, file.size_bytes, _DIGEST_BYTES):
        block = file.read(offset, min(_DIGEST_BYTES, file.size_bytes - offset))
        sha256.update(block)
        if offset < n_crc_bytes:
            crc = zlib.crc32(memoryview(block)[: n_crc_bytes - offset], crc)
    return sha256.hexdigest(), crc


def _channel_summaries(file: RecordingFile, layout: Layout) -> tuple[ChannelSummary, ...]:
    counts = _message_counts(file, layout)
    return tuple(
        ChannelSummary(
            channel_id=channel.id,
            topic=channel.topic,
            schema_name=schema.name if schema else "",
            schema_encoding=schema.encoding if schema else "",
            message_encoding=channel.message_encoding,
            message_count=counts.get(channel.id, 0) if counts is not None else None,
        )
        for channel in sorted(layout.channels.values(), key=lambda channel: (channel.topic, channel.id))
        for schema in [layout.schemas.get(channel.schema_id)]
    )


def _message_counts(file: RecordingFile, layout: Layout) -> Mapping[int, int] | None:
    """Messages per channel by the statistics, or by indexes; None where only reading everything tells."""
    if layout.statistics is not None:
        return layout.statistics.channel_message_counts
    if any(extent.channel_ids is None for extent in layout.extents):
        return None
    return _count_all(file, layout)


def _count_all(file: RecordingFile, layout: Layout) -> Counter[int]:
    """Messages per channel; those of chunks that cannot be read are not counted."""
    counts = Counter[int]()
    for extent in layout.extents:
        with suppress(Damage):
            counts += count_messages(file, extent)
    return counts


def _read_metadata(file: RecordingFile, layout: Layout) -> dict[str, dict[str, str]]:
    """The Metadata records by name; of several with one name, the last."""
    metadata = {}
    for index in layout.metadata:
        try:
            record = load_record(file, Metadata, index.offset)
        except Damage as damage:
            layout.losses.append(f"{damage} at byte {index.offset:,}")
            continue
        metadata[record.name] = record.metadata
    return metadata
