"""The layout of an MCAP file, found by one pass over its records that reads only their heads.

A chunk that the summary knows is skipped together with its message indexes, so an indexed file costs one
small read per chunk; a file without summary, chunk index or chunks is scanned record by record.
"""

from __future__ import annotations

import struct
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field
from io import BytesIO
from typing import TYPE_CHECKING

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)

from inspect_pipeline.recording.file import (
    MESSAGE_HEAD,
    RECORD_HEAD,
    Damage,
    Extent,
    RecordingFile,
    iter_records,
    read_chunk_head,
)
from inspect_pipeline.recording.summary import MAGIC, Summary, load_body, load_record, parse_record

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

INDEX_HEAD = struct.Struct("<HI")  # channel id, length of the entries
_RUN_BYTES = 4 << 20  # records outside chunks are read together up to this size
_DATA_END_BYTES = RECORD_HEAD.size + 4
_DATA_OPCODES = frozenset({
    Opcode.MESSAGE,
    Opcode.CHUNK,
    Opcode.MESSAGE_INDEX,
    Opcode.ATTACHMENT,
    Opcode.METADATA,
})  # fmt: skip


@dataclass(slots=True, eq=False)
class Layout:
    """What an MCAP file holds and where.

    data_end: offset where the data section ends: that of the Data End record, or of the first record
    that cannot be read. data_crc: the data_section_crc the file states, 0 when it states none.
    end: offset after the closing magic; the size of the file when there is none.
    has_early_end: whether messages follow a Data End record.
    losses: one phrase for each part that cannot be read.
    """

    header: Header
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    extents: list[Extent] = field(default_factory=list)
    attachments: list[AttachmentIndex] = field(default_factory=list)
    metadata: list[MetadataIndex] = field(default_factory=list)
    statistics: Statistics | None = None
    data_end: int = 0
    data_crc: int = 0
    end: int = 0
    has_early_end: bool = False
    losses: list[str] = field(default_factory=list)


class WrongIndexError(Exception):
    """Raised when the summary's chunk indexes disagree with the data section."""


def scan(file: RecordingFile, summary: Summary) -> Layout:
    """Scan the records of the data section, skipping the chunks that the summary knows.

    Raises WrongIndexError when those chunks are not what is found, Damage when there is no readable header.
    """
    known = summary.chunks
    layout = Layout(load_record(file, Header, len(MAGIC)), data_end=len(MAGIC), end=file.size_bytes)
    try:
        _scan_data(file, layout, known)
        while layout.data_end + _DATA_END_BYTES != summary.start and _skip_early_end(file, layout):
            _scan_data(file, layout, known)
    except Damage as damage:
        layout.losses.append(_lost_tail(file, damage, layout))
        _forget_cut_indexes(layout)
    if known and (layout.losses or not known.keys() <= {extent.offset for extent in layout.extents}):
        raise WrongIndexError
    if layout.has_early_end:
        layout.data_crc = 0
        layout.losses.append("a Data End record comes before the last messages")
    return layout


def _scan_data(file: RecordingFile, layout: Layout, known: Mapping[int, ChunkIndex]) -> None:
    """Add the records up to the next Data End, whose offset `layout.data_end` is then. Raises Damage."""
    while (head := file.record_head(layout.data_end))[0] != Opcode.DATA_END:
        layout.data_end += _step(file, layout, *head, known.get(layout.data_end))
    layout.data_crc = load_record(file, DataEnd, layout.data_end).data_section_crc


def _skip_early_end(file: RecordingFile, layout: Layout) -> bool:
    """Move `layout.data_end` to the first message after a Data End record, if there is one.

    Otherwise `layout.end` is set to the end of the summary and footer that follow.
    """
    at = layout.data_end + _DATA_END_BYTES
    with suppress(Damage):  # a damaged summary is reported by whoever reads it
        opcode = None
        while opcode != Opcode.FOOTER:
            opcode, length = file.record_head(at)
            if opcode in _DATA_OPCODES:
                layout.data_end, layout.has_early_end = at, True
                return True
            if not opcode:
                return False
            at += RECORD_HEAD.size + length
        if file.read(at, len(MAGIC)) == MAGIC:
            layout.end = at + len(MAGIC)
    return False


def _step(file: RecordingFile, layout: Layout, opcode: int, length: int, chunk: ChunkIndex | None) -> int:
    """Add the record at `layout.data_end`; return the number of bytes to the next. Raises Damage."""
    offset = layout.data_end
    size = RECORD_HEAD.size + length
    if chunk is not None:
        if (opcode, size) != (Opcode.CHUNK, chunk.chunk_length):
            raise WrongIndexError
        layout.extents.append(_chunk_extent(chunk))
        return size + chunk.message_index_length
    if not opcode:
        raise Damage("an invalid record follows")
    if opcode in _NOTED:
        _NOTED[opcode](file, layout, offset, length)
    return size


def _lost_tail(file: RecordingFile, damage: Damage, layout: Layout) -> str:
    """Say what is lost from the first unreadable record on; another recording may begin there."""
    n_left = file.size_bytes - layout.data_end
    if n_left >= len(MAGIC) and file.read(layout.data_end, len(MAGIC)) == MAGIC:
        layout.end, n_left = layout.data_end, 0
    if not n_left:
        return "the file has no end, as when a recorder is interrupted"
    return f"{damage} after byte {file.start + layout.data_end:,}: {n_left:,} bytes are lost"


def _forget_cut_indexes(layout: Layout) -> None:
    """Drop the message indexes after the last chunk of a truncated file, some of which may be missing."""
    extent = layout.extents[-1] if layout.extents else None
    if extent is None or extent.chunk is None:
        return
    chunk, end = extent.chunk, extent.offset + extent.length
    if layout.data_end == end + chunk.message_index_length:
        chunk.message_index_offsets, chunk.message_index_length = {}, 0
        extent.counts = None
        layout.data_end = end


def _chunk_extent(chunk: ChunkIndex) -> Extent:
    start_ns, end_ns = chunk.message_start_time, chunk.message_end_time
    return Extent(chunk.chunk_start_offset, chunk.chunk_length, start_ns, end_ns, chunk)


def _note_definition(file: RecordingFile, layout: Layout, offset: int, length: int) -> None:
    """Add a Schema or a Channel record."""
    read_definitions(load_body(file, offset, RECORD_HEAD.size + length), layout.schemas, layout.channels)


def _note_message(file: RecordingFile, layout: Layout, offset: int, length: int) -> None:
    """Add a message to the run of messages that ends here, or begin one."""
    if length < MESSAGE_HEAD.size:
        raise Damage("a message is shorter than its head")
    channel_id, _, log_time_ns, _ = MESSAGE_HEAD.unpack(
        file.read(offset + RECORD_HEAD.size, MESSAGE_HEAD.size)
    )
    size = RECORD_HEAD.size + length
    run = layout.extents[-1] if layout.extents else None
    is_next = run and not run.chunk and run.offset + run.length == offset
    if run is None or not is_next or run.length + size > _RUN_BYTES:
        run = Extent(offset, 0, log_time_ns, log_time_ns, counts={})
        layout.extents.append(run)
    run.length += size
    run.start_ns, run.end_ns = min(run.start_ns, log_time_ns), max(run.end_ns, log_time_ns)
    run.counts = run.counts or {}
    run.counts[channel_id] = run.counts.get(channel_id, 0) + 1


def _note_chunk(file: RecordingFile, layout: Layout, offset: int, length: int) -> None:
    head = read_chunk_head(file, offset, length)
    index = ChunkIndex(
        chunk_start_offset=offset,
        chunk_length=RECORD_HEAD.size + length,
        message_start_time=head.start_ns,
        message_end_time=head.end_ns,
        message_index_offsets={},
        message_index_length=0,
        compression=head.compression,
        compressed_size=head.data_size_bytes,
        uncompressed_size=head.uncompressed_size_bytes,
    )
    layout.extents.append(_chunk_extent(index))


def _note_message_index(file: RecordingFile, layout: Layout, offset: int, length: int) -> None:
    """Add a Message Index record to the chunk that it follows; ignore others."""
    extent = layout.extents[-1] if layout.extents else None
    if extent is None or extent.chunk is None or length < INDEX_HEAD.size:
        return
    if extent.offset + extent.length + extent.chunk.message_index_length != offset:
        return
    channel_id, entries_bytes = INDEX_HEAD.unpack(file.read(offset + RECORD_HEAD.size, INDEX_HEAD.size))
    extent.chunk.message_index_offsets[channel_id] = offset
    extent.chunk.message_index_length += RECORD_HEAD.size + length
    extent.counts = extent.counts or {}
    extent.counts[channel_id] = entries_bytes // 16


def _note_attachment(file: RecordingFile, layout: Layout, offset: int, length: int) -> None:
    """Index an Attachment record without reading its data."""
    stream = ReadDataStream(BytesIO(file.read(offset + RECORD_HEAD.size, min(length, 1 << 16))))
    try:
        log_time, create_time = stream.read8(), stream.read8()
        name, media_type = stream.read_prefixed_string(), stream.read_prefixed_string()
        data_size = stream.read8()
    except (McapError, struct.error, ValueError) as error:
        raise Damage("an attachment has an unreadable head") from error
    size = RECORD_HEAD.size + length
    layout.attachments.append(
        AttachmentIndex(offset, size, log_time, create_time, data_size, name, media_type)
    )


def _note_metadata(file: RecordingFile, layout: Layout, offset: int, length: int) -> None:
    record = parse_record(Metadata, load_body(file, offset + RECORD_HEAD.size, length))
    layout.metadata.append(MetadataIndex(offset, RECORD_HEAD.size + length, record.name))


_NOTED: dict[int, Callable[[RecordingFile, Layout, int, int], None]] = {
    Opcode.SCHEMA: _note_definition,
    Opcode.CHANNEL: _note_definition,
    Opcode.MESSAGE: _note_message,
    Opcode.CHUNK: _note_chunk,
    Opcode.MESSAGE_INDEX: _note_message_index,
    Opcode.ATTACHMENT: _note_attachment,
    Opcode.METADATA: _note_metadata,
}


def read_definitions(
    records: bytes, schemas: dict[int, Schema], channels: dict[int, Channel]
) -> Counter[int]:
    """Add new schemas and channels from a chunk's records; return the number of messages by channel."""
    counts = Counter[int]()
    for opcode, start, end in iter_records(records):
        if opcode == Opcode.MESSAGE:
            if end - start < MESSAGE_HEAD.size:
                raise Damage("a message is shorter than its head")
            counts[MESSAGE_HEAD.unpack_from(records, start)[0]] += 1
        elif opcode == Opcode.SCHEMA:
            schema = parse_record(Schema, records[start:end])
            schemas.setdefault(schema.id, schema)
        elif opcode == Opcode.CHANNEL:
            channel = parse_record(Channel, records[start:end])
            channels.setdefault(channel.id, channel)
    return counts
