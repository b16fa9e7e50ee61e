"""Extents of an MCAP file, which hold messages, and the records in them.

An `Extent` is a Chunk record, or a run of records that lie outside chunks. Read and decompressed, both
are the same thing, a sequence of records, so everything above this module treats them alike.
"""

from __future__ import annotations

import os
import stat
import struct
import zlib
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import lz4.frame
import zstandard
from mcap.opcode import Opcode

from inspect_pipeline.errors import RecordingError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path
    from types import TracebackType
    from typing import Self

    from mcap.records import ChunkIndex

RECORD_HEAD = struct.Struct("<BQ")  # opcode, length of the body
MESSAGE_HEAD = struct.Struct("<HIQQ")  # channel id, sequence, log time, publish time
MAX_CHUNK_BYTES = 256 << 20  # writers use 1 to 16 MiB; beyond this a length is damage or an attack
_CHUNK_HEAD = struct.Struct(
    "<QQQII"
)  # start, end, uncompressed size, uncompressed crc, length of compression
_MAX_COMPRESSION_NAME_BYTES = 32
_MAX_TINY_RECORDS, _MIN_COMPRESSED_BYTES = 1000, 2  # of a chunk, and of each record beyond those


class Damage(Exception):  # noqa: N818 - a fact about the file, turned into RecordingError by `recording`
    """Raised when a part of a recording cannot be read; the message is a phrase without the path."""


@contextmanager
def opened(path: Path, start: int = 0, size_bytes: int | None = None) -> Iterator[RecordingFile]:
    """Open a file, or `size_bytes` of it from `start` on, for reading.

    Raises RecordingError when it cannot be opened, and for any OSError of the block.
    """
    try:
        mode = path.stat().st_mode
        if not stat.S_ISREG(mode):
            what = "a folder" if stat.S_ISDIR(mode) else "no regular file"
            raise RecordingError(path, f"it is {what}, not an MCAP file", "name an MCAP file")
        with RecordingFile(path, start, size_bytes) as file:
            yield file
    except FileNotFoundError as error:
        raise RecordingError(path, "there is no such file", "check the name") from error
    except OSError as error:
        raise RecordingError(
            path, f"it cannot be read ({error.strerror})", "check rights and disk"
        ) from error


@contextmanager
def reading(path: Path, start: int = 0, size_bytes: int | None = None) -> Iterator[RecordingFile]:
    """Open a file as `opened` does, and raise RecordingError also for any Damage of the block."""
    with opened(path, start, size_bytes) as file:
        try:
            yield file
        except Damage as damage:
            raise RecordingError(path, str(damage), "name an intact MCAP file, or copy it again") from damage


class RecordingFile:
    """Random access to a range of bytes of a file; offsets count from the start of the range.

    Raises OSError when the file cannot be opened.
    """

    def __init__(self, path: Path, start: int = 0, size_bytes: int | None = None) -> None:
        self._descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        self.start = start
        all_bytes = os.fstat(self._descriptor).st_size
        self.size_bytes = all_bytes - start if size_bytes is None else size_bytes

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        os.close(self._descriptor)

    def read(self, offset: int, length: int) -> bytes:
        """Read exactly `length` bytes at `offset`. Raises Damage when the file is shorter."""
        if offset + length > self.size_bytes:
            raise Damage("the file is cut off")
        parts = []
        while length > 0:
            part = os.pread(self._descriptor, length, self.start + offset)
            if not part:
                raise Damage("the file became shorter while it was read")
            parts.append(part)
            offset, length = offset + len(part), length - len(part)
        return parts[0] if len(parts) == 1 else b"".join(parts)

    def record_head(self, offset: int) -> tuple[int, int]:
        """Return (opcode, length of the body) of the record at `offset`. Raises Damage when it is cut off."""
        opcode, length = RECORD_HEAD.unpack(self.read(offset, RECORD_HEAD.size))
        if offset + RECORD_HEAD.size + length > self.size_bytes:
            raise Damage("the file is cut off")
        return opcode, length


@dataclass(slots=True, eq=False)
class Extent:
    """Where messages lie: a Chunk record (`chunk` set), or a run of records outside chunks.

    `counts` has the messages per channel id where a scan or Message Index records give them.
    Times are the first and last log time of its messages.
    """

    offset: int
    length: int
    start_ns: int
    end_ns: int
    chunk: ChunkIndex | None = None
    counts: dict[int, int] | None = None

    @property
    def channel_ids(self) -> frozenset[int] | None:
        """The channels with messages here; None when that is only known after reading."""
        if self.counts is not None:
            return frozenset(i for i, count in self.counts.items() if count)
        if self.chunk is not None and self.chunk.message_index_offsets:
            return frozenset(self.chunk.message_index_offsets)
        return None


class ChunkHead(NamedTuple):
    """The fields of a Chunk record before its data; `data_offset` counts from the start of the record."""

    start_ns: int
    end_ns: int
    uncompressed_size_bytes: int
    uncompressed_crc: int
    compression: str
    data_offset: int
    data_size_bytes: int


def read_chunk_head(file: RecordingFile, offset: int, length: int) -> ChunkHead:
    """Read the head of the Chunk record at `offset` with a body of `length` bytes. Raises Damage."""
    size = min(length, _CHUNK_HEAD.size + _MAX_COMPRESSION_NAME_BYTES + 8)
    body = file.read(offset + RECORD_HEAD.size, size)
    try:
        start, end, uncompressed_size, crc, name_length = _CHUNK_HEAD.unpack_from(body)
        name_end = _CHUNK_HEAD.size + name_length
        (data_size,) = struct.unpack_from("<Q", body, name_end)
        name = body[_CHUNK_HEAD.size : name_end].decode("ascii")
    except (struct.error, UnicodeDecodeError) as error:
        raise Damage("a chunk has an unreadable head") from error
    if name_end + 8 + data_size > length:
        raise Damage("a chunk is shorter than it says")
    data_offset = RECORD_HEAD.size + name_end + 8
    return ChunkHead(start, end, uncompressed_size, crc, name, data_offset, data_size)


def read_extent(file: RecordingFile, extent: Extent) -> bytes:
    """Read the records of an extent, decompressed and checked against the chunk's CRC. Raises Damage."""
    if extent.chunk is None:
        if extent.length > MAX_CHUNK_BYTES:
            raise Damage(f"a message claims more than {MAX_CHUNK_BYTES >> 20} MiB")
        return file.read(extent.offset, extent.length)
    opcode, length = file.record_head(extent.offset)
    if opcode != Opcode.CHUNK:
        raise Damage("a chunk is not where the index says")
    head = read_chunk_head(file, extent.offset, length)
    if max(head.uncompressed_size_bytes, head.data_size_bytes) > MAX_CHUNK_BYTES:
        raise Damage(f"a chunk claims more than {MAX_CHUNK_BYTES >> 20} MiB")
    data = file.read(extent.offset + head.data_offset, head.data_size_bytes)
    records = _decompress(head.compression, data, head.uncompressed_size_bytes)
    if head.uncompressed_crc and zlib.crc32(records) != head.uncompressed_crc:
        raise Damage("a chunk does not match its CRC")
    _check_number_of_records(records, head.data_size_bytes)
    return records


def _check_number_of_records(records: bytes, n_compressed: int) -> None:
    """Raise Damage for a chunk that expands to a million messages, each of which takes time and rows.

    Records differ at least in their times, so each takes some bytes even when compressed.
    """
    n_most = _MAX_TINY_RECORDS + n_compressed // _MIN_COMPRESSED_BYTES
    if len(records) > n_most * RECORD_HEAD.size:
        for i, _ in enumerate(iter_records(records)):
            if i >= n_most:
                raise Damage(f"a chunk of {n_compressed:,} bytes claims more than {n_most:,} records")


def _decompress(compression: str, data: bytes, size_bytes: int) -> bytes:
    if size_bytes == 0:
        return b""
    kind = compression.lower()
    if kind not in {"", "zstd", "lz4"}:
        raise Damage(f"a chunk is compressed with {compression!r}, not none, lz4 or zstd")
    try:
        records = data if not kind else (_from_zstd if kind == "zstd" else _from_lz4)(data, size_bytes)
    except (zstandard.ZstdError, RuntimeError, EOFError, MemoryError) as error:
        raise Damage(f"a chunk cannot be decompressed with {compression}") from error
    if len(records) != size_bytes:
        raise Damage("a chunk has another size than it says")
    return records


def _from_zstd(data: bytes, size_bytes: int) -> bytes:
    """Decompress the first `size_bytes` of one or several frames."""
    decompressor = zstandard.ZstdDecompressor()
    # The frame's own size wins over max_output_size, so it is compared before memory is taken.
    if zstandard.frame_content_size(data) in (-1, size_bytes):
        return decompressor.decompress(data, max_output_size=size_bytes)
    if zstandard.frame_content_size(data) > size_bytes:
        return b""
    with decompressor.stream_reader(data, read_across_frames=True) as reader:
        return reader.read(size_bytes)


def _from_lz4(data: bytes, size_bytes: int) -> bytes:
    """Decompress the first `size_bytes` of one or several frames."""
    records = bytearray()
    while data and len(records) < size_bytes:
        frame = lz4.frame.LZ4FrameDecompressor()
        records += frame.decompress(data, max_length=size_bytes - len(records))
        if not frame.eof:
            break
        data = frame.unused_data or b""
    return bytes(records)


def iter_records(records: bytes) -> Iterator[tuple[int, int, int]]:
    """Iterate over (opcode, start of the body, end of the body) of the records. Raises Damage."""
    at, end = 0, len(records)
    while at < end:
        if end - at < RECORD_HEAD.size:
            raise Damage("a chunk ends inside a record")
        opcode, length = RECORD_HEAD.unpack_from(records, at)
        at += RECORD_HEAD.size
        if length > end - at or not opcode:
            raise Damage("a chunk ends inside a record")
        yield opcode, at, at + length
        at += length


def iter_messages(records: bytes) -> Iterator[tuple[int, int, int]]:
    """Iterate over (channel id, start of the body, end of the body) of the messages. Raises Damage."""
    for opcode, start, end in iter_records(records):
        if opcode != Opcode.MESSAGE:
            continue
        if end - start < MESSAGE_HEAD.size:
            raise Damage("a message is shorter than its head")
        yield MESSAGE_HEAD.unpack_from(records, start)[0], start, end


def message_entries(records: bytes, channel_ids: frozenset[int]) -> list[tuple[int, int, int]]:
    """Return (log time, start, end of the body) of each message of `channel_ids`, in file order.

    Raises Damage.
    """
    entries = []
    for channel_id, start, end in iter_messages(records):
        if channel_id in channel_ids:
            entries.append((MESSAGE_HEAD.unpack_from(records, start)[2], start, end))
    return entries
