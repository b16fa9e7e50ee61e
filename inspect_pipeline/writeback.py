"""Annotations written back: appended to a copy of the recording, or to a file of their own beside it.

    with annotated_copy(recording, target) as out:
        channel_id = out.add_channel(topic, schema_name=..., message_encoding=..., ...)
        out.write(channel_id, log_time_ns, publish_time_ns, data)

A copy begins with the bytes of the source up to its Data End record, unchanged, so every offset in its
indexes stays right; then come chunks of annotations and a new summary of everything.
"""

from __future__ import annotations

import errno
import os
import struct
import zlib
from contextlib import contextmanager
from importlib.metadata import version
from typing import TYPE_CHECKING

import zstandard
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Header, Metadata, MetadataIndex, Schema

from inspect_pipeline.errors import RecordingError
from inspect_pipeline.recording_extents import RECORD_HEAD
from inspect_pipeline.recording_summary import MAGIC
from inspect_pipeline.writeback_summary import Contents, encode_end, encode_records

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path
    from typing import BinaryIO

    from inspect_pipeline.recording import Recording

# Short in time, so that a player that seeks need not fetch the annotations of the whole flight.
_CHUNK_NS = 5_000_000_000
_CHUNK_BYTES = 256 << 10
_COPY_BYTES = 1 << 30
_MAX_ID = 0xFFFF
_MESSAGE = struct.Struct("<BQHIQQ")  # opcode, length, channel id, sequence, log time, publish time
_MESSAGE_HEAD_BYTES = _MESSAGE.size - RECORD_HEAD.size
_CHUNK = struct.Struct("<BQQQQII4sQ")  # opcode, length, start, end, size, crc, compression, compressed size
_INDEX = struct.Struct("<BQHI")  # opcode, length, channel id, length of the entries
_COMPRESSION = b"zstd"
_NO_COPY_RANGE = {errno.EXDEV, errno.EINVAL, errno.ENOSYS, errno.EOPNOTSUPP, errno.EPERM}


@contextmanager
def annotated_copy(source: Recording, target: Path) -> Iterator[AnnotationWriter]:
    """Write a copy of `source` with annotations to `target`, which must not exist.

    On a clean exit the copy is complete and on disk; on an exception it is removed. Raises RecordingError
    when the source is an annotated copy itself or changes meanwhile, OSError when the target cannot be
    written.
    """
    _refuse_annotated(source)
    before = _fingerprint(source.path)
    end = source.layout.data_end
    with _new_file(target) as file, source.path.open("rb") as original:
        _copy_range(original.fileno(), file.fileno(), end)
        file.seek(end)
        writer = AnnotationWriter(file, source, Contents.of(source), end, source.layout.data_crc)
        yield writer
        writer.finish()
        if _fingerprint(source.path) != before or before[0] != source.size_bytes:
            raise RecordingError(source.path, "it changed while it was copied", "wait until it is complete")


@contextmanager
def sidecar(source: Recording, target: Path) -> Iterator[AnnotationWriter]:
    """Write a file with nothing but annotations of `source` to `target`; else as `annotated_copy`."""
    _refuse_annotated(source)
    header = Header(profile="", library=f"lsnet-pipe {version('lsnet-pipe')}")
    start = MAGIC + encode_records([header])
    with _new_file(target) as file:
        file.write(start)
        writer = AnnotationWriter(file, source, Contents(), len(start), zlib.crc32(start))
        yield writer
        writer.finish()


class AnnotationWriter:
    """Appends channels, messages and metadata behind the `position` bytes that `file` already has.

    `data_crc` is the CRC-32 of those bytes, or 0 when it is not known.
    """

    def __init__(
        self, file: BinaryIO, source: Recording, contents: Contents, position: int, data_crc: int
    ) -> None:
        self._file = file
        self._source = source
        self._contents = contents
        self._position = position
        self._data_crc = data_crc
        self._chunk = _ChunkBuilder()
        self._compressor = zstandard.ZstdCompressor(level=1)
        self._schema_ids: dict[tuple[str, str, bytes], int] = {}

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
        """The id of a new channel. Raises RecordingError when the recording has a channel of this topic."""
        taken = (*self._source.layout.channels.values(), *self._contents.channels.values())
        if any(channel.topic == topic for channel in taken):
            raise RecordingError(
                self._source.path, f"it has a channel {topic} already", "write its annotations to a sidecar"
            )
        schema_id = self._schema_id(schema_name, schema_encoding, schema_data)
        channel_id = self._free_id(self._contents.channels)
        channel = Channel(channel_id, topic, message_encoding, dict(metadata), schema_id)
        self._contents.channels[channel_id] = channel
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

    def finish(self) -> None:
        """Write what is left, the summary and the footer."""
        self._flush_chunk()
        self._file.write(encode_end(self._contents, self._position, self._data_crc))

    def _schema_id(self, name: str, encoding: str, data: bytes) -> int:
        key = (name, encoding, data)
        if key not in self._schema_ids:
            schema = Schema(id=self._free_id(self._contents.schemas), name=name, encoding=encoding, data=data)
            self._schema_ids[key] = schema.id
            self._contents.schemas[schema.id] = schema
            self._chunk.records += encode_records([schema])
        return self._schema_ids[key]

    def _free_id(self, used: Mapping[int, object]) -> int:
        free = max(used, default=0) + 1
        if free > _MAX_ID:
            raise RecordingError(self._source.path, "it has no channel ids left", "write a sidecar")
        return free

    def _flush_chunk(self) -> None:
        if self._chunk.records:
            encoded, index = self._chunk.encode(self._compressor, self._position)
            self._contents.add_chunk(index)
            self._append(encoded)
            self._chunk = _ChunkBuilder()

    def _append(self, data: bytes) -> None:
        self._file.write(data)
        self._position += len(data)
        if self._data_crc:
            self._data_crc = zlib.crc32(data, self._data_crc)


class _ChunkBuilder:
    """The records of one chunk in the making, and where its messages are among them."""

    def __init__(self) -> None:
        self.records = bytearray()
        self._index: dict[int, list[int]] = {}  # by channel: log time, offset, log time, offset, ...
        self._start_ns = self._end_ns = 0

    def is_full_at(self, log_time_ns: int) -> bool:
        """Whether a message of this time belongs into the next chunk."""
        if not self._index:
            return False
        span_ns = max(self._end_ns, log_time_ns) - min(self._start_ns, log_time_ns)
        return span_ns > _CHUNK_NS or len(self.records) >= _CHUNK_BYTES

    def add(
        self, channel_id: int, sequence: int, log_time_ns: int, publish_time_ns: int, data: bytes
    ) -> None:
        if not self._index:
            self._start_ns = self._end_ns = log_time_ns
        self._start_ns = min(self._start_ns, log_time_ns)
        self._end_ns = max(self._end_ns, log_time_ns)
        self._index.setdefault(channel_id, []).extend((log_time_ns, len(self.records)))
        length = _MESSAGE_HEAD_BYTES + len(data)
        self.records += _MESSAGE.pack(
            Opcode.MESSAGE, length, channel_id, sequence, log_time_ns, publish_time_ns
        )
        self.records += data

    def encode(self, compressor: zstandard.ZstdCompressor, offset: int) -> tuple[bytes, ChunkIndex]:
        """The Chunk record with its Message Index records, to stand at `offset`, and its Chunk Index."""
        data = compressor.compress(self.records)
        head = _CHUNK.pack(
            Opcode.CHUNK,
            _CHUNK.size - RECORD_HEAD.size + len(data),
            self._start_ns,
            self._end_ns,
            len(self.records),
            zlib.crc32(self.records),
            len(_COMPRESSION),
            _COMPRESSION,
            len(data),
        )
        encoded = bytearray(head + data)
        chunk_length = len(encoded)
        index_offsets = {}
        for channel_id, entries in self._index.items():
            index_offsets[channel_id] = offset + len(encoded)
            entries_bytes = 8 * len(entries)
            length = _INDEX.size - RECORD_HEAD.size + entries_bytes
            encoded += _INDEX.pack(Opcode.MESSAGE_INDEX, length, channel_id, entries_bytes)
            encoded += struct.pack(f"<{len(entries)}Q", *entries)
        index = ChunkIndex(
            message_start_time=self._start_ns,
            message_end_time=self._end_ns,
            chunk_start_offset=offset,
            chunk_length=chunk_length,
            message_index_offsets=index_offsets,
            message_index_length=len(encoded) - chunk_length,
            compression=_COMPRESSION.decode(),
            compressed_size=len(data),
            uncompressed_size=len(self.records),
        )
        return bytes(encoded), index


def _refuse_annotated(source: Recording) -> None:
    if source.is_annotated_copy:
        raise RecordingError(
            source.path, "it carries annotations already", "annotate the recording it is from"
        )


def _fingerprint(path: Path) -> tuple[int, int, int]:
    status = path.stat()
    return status.st_size, status.st_mtime_ns, status.st_ino


@contextmanager
def _new_file(target: Path) -> Iterator[BinaryIO]:
    """A file at `target` that is on disk after a clean exit and gone after an exception."""
    with target.open("xb") as file:
        try:
            yield file
            file.flush()
            os.fsync(file.fileno())
        except BaseException:
            target.unlink(missing_ok=True)
            raise


def _copy_range(source: int, target: int, length: int) -> None:
    """Copy the first `length` bytes between descriptors inside the kernel, sharing blocks where it can."""
    offset = 0
    while offset < length:
        count = min(length - offset, _COPY_BYTES)
        try:
            n_copied = os.copy_file_range(source, target, count, offset, offset)
        except OSError as error:
            if error.errno not in _NO_COPY_RANGE:
                raise
            os.lseek(target, offset, os.SEEK_SET)
            n_copied = os.sendfile(target, source, offset, count)
        if n_copied == 0:
            raise OSError(errno.EIO, "the recording became shorter while it was copied")
        offset += n_copied
