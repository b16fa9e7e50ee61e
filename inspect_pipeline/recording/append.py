"""Write annotations back: to a copy of the recording, or to a sidecar file of their own.

    with annotated_copy(recording, target) as out:
        channel_id = out.add_channel(topic, schema_name=..., message_encoding=..., ...)
        out.write(channel_id, log_time_ns, publish_time_ns, data)

A copy begins with the bytes of the source up to its Data End record, unchanged, so every offset in its
indexes stays right; then come chunks of annotations and a new summary of everything.
"""

from __future__ import annotations

import errno
import os
import zlib
from contextlib import contextmanager, suppress
from dataclasses import replace
from typing import TYPE_CHECKING

import zstandard
from mcap.records import Channel, Header, Metadata, MetadataIndex, Schema

from inspect_pipeline.errors import AnnotationChannelError, RecordingError
from inspect_pipeline.recording.append_chunks import ChunkBuilder, encode_message_indexes, message_index
from inspect_pipeline.recording.append_summary import Contents, encode_end, encode_records
from inspect_pipeline.recording.file import Damage, read_extent
from inspect_pipeline.recording.join import copying_prefix, join_parts
from inspect_pipeline.recording.part import open_parts
from inspect_pipeline.recording.summary import MAGIC
from inspect_pipeline.resources import app_version

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from collections.abc import Set as AbstractSet
    from pathlib import Path
    from typing import BinaryIO

    from inspect_pipeline.recording.part import Part
    from inspect_pipeline.recording.reader import Recording

_MAX_ID = 0xFFFF


@contextmanager
def annotated_copy(source: Recording, target: Path) -> Iterator[AnnotationWriter]:
    """Write a copy of `source` with annotations to `target`, which must not exist.

    A recording of several parts, or with messages after its end, is written as one file first.
    On a clean exit the copy is complete, on an exception it is removed. Raises RecordingError when the source
    is an annotated copy itself or changes meanwhile, OSError when the target cannot be written.
    """
    _refuse_annotated(source)
    (first, *others) = source.parts
    copying = _joined_copy if others or first.layout.has_early_end else _prefix_copy
    with _removed_on_error(target), unchanged(source), copying(source, target) as writer:
        yield writer


@contextmanager
def _prefix_copy(source: Recording, target: Path) -> Iterator[AnnotationWriter]:
    """Copy the bytes of the only part up to its Data End record."""
    (part,) = source.parts
    end = part.layout.data_end
    with target.open("xb") as file, part.path.open("rb") as original:
        file.seek(end)
        writer = AnnotationWriter(file, source, Contents.of(part), end, part.layout.data_crc)
        writer.index_cut_chunk(part)
        with copying_prefix(original, file, end):
            yield writer
            writer.finish()


@contextmanager
def _joined_copy(source: Recording, target: Path) -> Iterator[AnnotationWriter]:
    """Merge all parts into one file, and write annotations in place of its summary."""
    _, losses = join_parts(source, target)
    (joined,) = open_parts(target)
    end = joined.layout.data_end
    with target.open("r+b") as file:
        file.truncate(end)
        file.seek(end)
        contents, data_crc = Contents.of(joined), joined.layout.data_crc
        writer = AnnotationWriter(file, source, contents, end, data_crc, losses=losses)
        yield writer
        writer.finish()


@contextmanager
def sidecar(source: Recording, target: Path, profile: str = "") -> Iterator[AnnotationWriter]:
    """Write a file with nothing but annotations of `source` to `target`; otherwise like `annotated_copy`.

    `profile` is that of its header, "ros2" when all its messages are.
    """
    _refuse_annotated(source)
    header = Header(profile=profile, library=f"lsnet-pipe {app_version()}")
    start = MAGIC + encode_records([header])
    with _removed_on_error(target), unchanged(source), target.open("xb") as file:
        file.write(start)
        writer = AnnotationWriter(file, source, Contents(), len(start), zlib.crc32(start))
        yield writer
        writer.finish()


@contextmanager
def unchanged(source: Recording) -> Iterator[None]:
    """Raise RecordingError on a clean exit when a file is no longer the one that was opened."""
    before = {path: _fingerprint(path) for path in source.files}
    yield
    for path, size_bytes in source.files.items():
        if _fingerprint(path) != before[path] or before[path][0] != size_bytes:
            raise RecordingError(path, "it changed while it was read", "wait until it is complete")


class AnnotationWriter:
    """Appends channels, messages and metadata to a file that has `position` bytes so far.

    `data_crc` is the CRC-32 of those bytes, or 0 when it is not known. `losses` has a phrase for each stretch
    of the source that could not be copied.
    """

    def __init__(
        self,
        file: BinaryIO,
        source: Recording,
        contents: Contents,
        position: int,
        data_crc: int,
        *,
        losses: tuple[str, ...] = (),
    ) -> None:
        self.losses = losses
        self._file = file
        self._source = source
        self._contents = contents
        self._position = position
        self._data_crc = data_crc
        self._chunk = ChunkBuilder()
        self._compressor = zstandard.ZstdCompressor(level=1)
        self._schema_ids: dict[tuple[str, str, bytes], int] = {}
        self._topics = {channel.topic for channel in source.channels}
        self._topics.update(channel.topic for channel in contents.channels.values())

    def add_channel(
        self,
        topic: str,
        *,
        schema_name: str,
        schema_encoding: str,
        schema_data: bytes,
        message_encoding: str,
        metadata: Mapping[str, str],
    ) -> int:
        """Add a channel and return its id. Raises AnnotationChannelError if the recording has this topic."""
        if topic in self._topics:
            raise AnnotationChannelError(self._source.path, f"it has a channel {topic} already")
        self._topics.add(topic)
        schema_id = self._schema_id(schema_name, schema_encoding, schema_data)
        channel_id = self._free_id(self._contents.used_channel_ids)
        channel = Channel(channel_id, topic, message_encoding, dict(metadata), schema_id)
        self._contents.channels[channel_id] = channel
        self._contents.used_channel_ids.add(channel_id)
        self._chunk.records += encode_records([channel])
        return channel_id

    def write(self, channel_id: int, log_time_ns: int, publish_time_ns: int, data: bytes) -> None:
        """Append a message."""
        if self._chunk.is_full_at(log_time_ns):
            self._flush_chunk()
        sequence = self._contents.message_counts[channel_id]
        self._contents.message_counts[channel_id] = sequence + 1
        self._chunk.add(channel_id, sequence, log_time_ns, publish_time_ns, data)

    def add_metadata(self, name: str, metadata: Mapping[str, str]) -> None:
        """Append a Metadata record."""
        record = encode_records([Metadata(name=name, metadata=dict(metadata))])
        self._contents.metadata.append(MetadataIndex(self._position, len(record), name))
        self._append(record)

    def index_cut_chunk(self, part: Part) -> None:
        """Append the message indexes that are missing after the last chunk of a truncated file.

        Players refuse a file in which only some chunks have indexes.
        """
        last = part.layout.extents[-1:]
        chunk = last[0].chunk if last and part.layout.losses else None
        if chunk is None or chunk.message_index_offsets or last[0].offset + last[0].length != self._position:
            return
        with suppress(Damage), part.open() as file:
            index = message_index(read_extent(file, last[0]))
            encoded, offsets = encode_message_indexes(index, self._position)
            self._contents.chunks[-1] = replace(
                chunk, message_index_offsets=offsets, message_index_length=len(encoded)
            )
            self._append(encoded)

    def finish(self) -> None:
        """Write the last chunk, the summary and the footer."""
        self._flush_chunk()
        self._file.write(encode_end(self._contents, self._position, self._data_crc))

    def _schema_id(self, name: str, encoding: str, data: bytes) -> int:
        key = (name, encoding, data)
        if key not in self._schema_ids:
            schema_id = self._free_id(self._contents.schemas.keys())
            schema = Schema(id=schema_id, name=name, encoding=encoding, data=data)
            self._schema_ids[key] = schema.id
            self._contents.schemas[schema.id] = schema
            self._chunk.records += encode_records([schema])
        return self._schema_ids[key]

    def _free_id(self, used: AbstractSet[int]) -> int:
        """Return the id above all used ones, or the lowest free one when there is none above."""
        free = max(used, default=0) + 1
        if free > _MAX_ID:
            free = next((i for i in range(1, _MAX_ID) if i not in used), 0)
        if not free:
            raise AnnotationChannelError(self._source.path, "it has no channel ids left")
        return free

    def _flush_chunk(self) -> None:
        if self._chunk.records:
            encoded, index = self._chunk.encode(self._compressor, self._position)
            self._contents.add_chunk(index)
            self._append(encoded)
            self._chunk = ChunkBuilder()

    def _append(self, data: bytes) -> None:
        self._file.write(data)
        self._position += len(data)
        if self._data_crc:
            self._data_crc = zlib.crc32(data, self._data_crc)


def _refuse_annotated(source: Recording) -> None:
    if source.is_annotated_copy:
        raise RecordingError(
            source.path, "it carries annotations already", "annotate the recording it is from"
        )


def _fingerprint(path: Path) -> tuple[int, int, int]:
    try:
        status = path.stat()
    except OSError as error:
        raise RecordingError(path, f"it cannot be read ({error.strerror})", "check the disk") from error
    return status.st_size, status.st_mtime_ns, status.st_ino


@contextmanager
def _removed_on_error(target: Path) -> Iterator[None]:
    """Remove `target` after an exception. Raises FileExistsError when it exists already."""
    if target.exists():
        raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(target))
    try:
        yield
    except BaseException:
        target.unlink(missing_ok=True)
        raise
