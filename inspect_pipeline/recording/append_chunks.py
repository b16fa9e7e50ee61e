"""Chunk records, and the Message Index records that follow each."""

from __future__ import annotations

import struct
import zlib
from typing import TYPE_CHECKING

from mcap.opcode import Opcode
from mcap.records import ChunkIndex

from inspect_pipeline.recording.file import MESSAGE_HEAD, RECORD_HEAD, Damage, iter_records

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import zstandard

# Short in time, so that a player that seeks need not fetch the annotations of the whole flight.
_CHUNK_NS = 5_000_000_000
_CHUNK_BYTES = 256 << 10
_MESSAGE = struct.Struct("<BQHIQQ")  # opcode, length, channel id, sequence, log time, publish time
_MESSAGE_HEAD_BYTES = _MESSAGE.size - RECORD_HEAD.size
_CHUNK = struct.Struct("<BQQQQII4sQ")  # opcode, length, start, end, size, crc, compression, compressed size
_INDEX = struct.Struct("<BQHI")  # opcode, length, channel id, length of the entries
_COMPRESSION = b"zstd"


class ChunkBuilder:
    """Collects the records of a chunk, and the offsets of its messages."""

    def __init__(self) -> None:
        self.records = bytearray()
        self._index: dict[int, list[int]] = {}  # by channel: log time, offset, log time, offset, ...
        self._start_ns = self._end_ns = 0

    def is_full_at(self, log_time_ns: int) -> bool:
        """Whether a message of this time belongs in the next chunk."""
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
        """Encode a Chunk record for `offset` with its Message Index records; also return its Chunk Index."""
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
        chunk = head + data
        indexes, index_offsets = encode_message_indexes(self._index, offset + len(chunk))
        index = ChunkIndex(
            message_start_time=self._start_ns,
            message_end_time=self._end_ns,
            chunk_start_offset=offset,
            chunk_length=len(chunk),
            message_index_offsets=index_offsets,
            message_index_length=len(indexes),
            compression=_COMPRESSION.decode(),
            compressed_size=len(data),
            uncompressed_size=len(self.records),
        )
        return chunk + indexes, index


def message_index(records: bytes) -> dict[int, list[int]]:
    """Return log time, offset, log time, offset, ... of the messages by channel id. Raises Damage."""
    index: dict[int, list[int]] = {}
    for opcode, start, end in iter_records(records):
        if opcode == Opcode.MESSAGE:
            if end - start < MESSAGE_HEAD.size:
                raise Damage("a message is shorter than its head")
            channel_id, _, log_time_ns, _ = MESSAGE_HEAD.unpack_from(records, start)
            index.setdefault(channel_id, []).extend((log_time_ns, start - RECORD_HEAD.size))
    return index


def encode_message_indexes(index: Mapping[int, Sequence[int]], offset: int) -> tuple[bytes, dict[int, int]]:
    """Encode the Message Index records of a `message_index` for `offset`; also return their offsets."""
    encoded = bytearray()
    offsets = {}
    for channel_id, entries in index.items():
        offsets[channel_id] = offset + len(encoded)
        entries_bytes = 8 * len(entries)
        length = _INDEX.size - RECORD_HEAD.size + entries_bytes
        encoded += _INDEX.pack(Opcode.MESSAGE_INDEX, length, channel_id, entries_bytes)
        encoded += struct.pack(f"<{len(entries)}Q", *entries)
    return bytes(encoded), offsets
