"""Single records, and the summary section at the end of an MCAP file."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass, field
from io import BytesIO
from typing import TYPE_CHECKING, TypeVar

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    ChunkIndex,
    Footer,
    McapRecord,
    Schema,
    Statistics,
)

from inspect_pipeline.recording.file import RECORD_HEAD, Damage, iter_records

if TYPE_CHECKING:
    from inspect_pipeline.recording.file import RecordingFile

_R = TypeVar("_R", bound=McapRecord)
MAGIC = b"\x89MCAP0\r\n"
_FOOTER_BYTES = RECORD_HEAD.size + 20
_MAX_LOADED_BYTES = 256 << 20  # for one record or a summary that is loaded whole
_MAX_MESSAGES = 1 << 48  # beyond this statistics are damaged, and messages are counted
_SUMMARY_RECORDS: dict[int, type[McapRecord]] = {
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.CHUNK_INDEX: ChunkIndex,
    Opcode.STATISTICS: Statistics,
}


@dataclass(slots=True, eq=False)
class Summary:
    """The records of the summary section.

    chunks: the chunk indexes by the offset of their chunk. start: offset of the section, which is that of the
    footer when there is no summary, and None when the end of the file cannot be read. loss: why not.
    """

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: dict[int, ChunkIndex] = field(default_factory=dict)
    statistics: Statistics | None = None
    start: int | None = None
    loss: str | None = None


def parse_record(kind: type[_R], body: bytes) -> _R:
    """Parse the body of a record of `kind`. Raises Damage."""
    try:
        record: _R = kind.read(ReadDataStream(BytesIO(body)))  # type: ignore[attr-defined]
    except (McapError, struct.error, ValueError) as error:
        raise Damage(f"a {kind.__name__} record cannot be read") from error
    return record


def load_record(file: RecordingFile, kind: type[_R], offset: int) -> _R:
    """Read the record of `kind` at `offset`. Raises Damage."""
    _, length = file.record_head(offset)
    return parse_record(kind, load_body(file, offset + RECORD_HEAD.size, length))


def load_body(file: RecordingFile, offset: int, length: int) -> bytes:
    """Read the body of a record. Raises Damage."""
    if length > _MAX_LOADED_BYTES:
        raise Damage(f"a record claims more than {_MAX_LOADED_BYTES >> 20} MiB")
    return file.read(offset, length)


def read_summary(file: RecordingFile) -> Summary:
    """Read the summary section: empty when there is none, or with `loss` set when it is damaged."""
    try:
        start, section = _summary_section(file)
        return _parse_summary(start, section)
    except Damage as damage:
        return Summary(loss=f"{damage}, its data were scanned instead")


def _summary_section(file: RecordingFile) -> tuple[int, bytes]:
    footer_offset = file.size_bytes - len(MAGIC) - _FOOTER_BYTES
    if footer_offset < len(MAGIC) or file.read(file.size_bytes - len(MAGIC), len(MAGIC)) != MAGIC:
        raise Damage("its end is missing")
    footer = load_record(file, Footer, footer_offset)
    if footer.summary_start == 0:
        return footer_offset, b""
    section = load_body(file, footer.summary_start, max(footer_offset - footer.summary_start, 0))
    checked = section + file.read(footer_offset, _FOOTER_BYTES - 4)
    if footer.summary_crc and zlib.crc32(checked) != footer.summary_crc:
        raise Damage("its summary does not match its CRC")
    return footer.summary_start, section


def _parse_summary(offset: int, section: bytes) -> Summary:
    summary = Summary(start=offset)
    for opcode, start, end in iter_records(section):
        if opcode in (Opcode.MESSAGE, Opcode.CHUNK):
            raise Damage("its summary holds messages")
        kind = _SUMMARY_RECORDS.get(opcode)
        record = parse_record(kind, section[start:end]) if kind else None
        if isinstance(record, Schema):
            summary.schemas[record.id] = record
        elif isinstance(record, Channel):
            summary.channels[record.id] = record
        elif isinstance(record, ChunkIndex):
            summary.chunks[record.chunk_start_offset] = record
        elif isinstance(record, Statistics):
            # Some writers leave the counts of channels out.
            n_messages = sum(record.channel_message_counts.values())
            is_known = n_messages == record.message_count <= _MAX_MESSAGES
            summary.statistics = record if is_known else None
    return summary
