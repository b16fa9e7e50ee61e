"""The summary section of a written file, which covers the records of the source and those added."""

from __future__ import annotations

import zlib
from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from inspect_pipeline.recording.part import part_counts
from inspect_pipeline.recording.summary import MAGIC

if TYPE_CHECKING:
    from collections.abc import Iterable

    from mcap.records import McapRecord

    from inspect_pipeline.recording.part import Part

_FOOTER_CRC_BYTES = 4


@dataclass(slots=True, eq=False)
class Contents:
    """The records that the summary of a file repeats or points to.

    has_loose_messages: messages outside chunks, which no index can point to.
    used_channel_ids: those of the channels, and those that messages have without their channel being known.
    start_ns, end_ns: first and last log time, None without messages.
    """

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: list[ChunkIndex] = field(default_factory=list)
    attachments: list[AttachmentIndex] = field(default_factory=list)
    metadata: list[MetadataIndex] = field(default_factory=list)
    message_counts: Counter[int] = field(default_factory=Counter)
    start_ns: int | None = None
    end_ns: int | None = None
    has_loose_messages: bool = False
    used_channel_ids: set[int] = field(default_factory=set)

    @classmethod
    def of(cls, part: Part) -> Contents:
        """Return the contents of an MCAP file."""
        layout = part.layout
        counts = part_counts(part)
        extents = [e for e in layout.extents if e.channel_ids is None or e.channel_ids]
        ids = set[int]().union(*(extent.channel_ids or () for extent in layout.extents))
        return cls(
            schemas=dict(layout.schemas),
            channels=dict(layout.channels),
            chunks=[extent.chunk for extent in layout.extents if extent.chunk],
            attachments=list(layout.attachments),
            metadata=list(layout.metadata),
            message_counts=counts,
            start_ns=min((e.start_ns for e in extents), default=0) if counts.total() else None,
            end_ns=max((e.end_ns for e in extents), default=0) if counts.total() else None,
            used_channel_ids=ids.union(layout.channels, counts),
            has_loose_messages=any(extent.chunk is None for extent in layout.extents),
        )

    def add_chunk(self, chunk: ChunkIndex) -> None:
        """Add a chunk and its time range; the caller counts its messages."""
        self.chunks.append(chunk)
        if chunk.message_index_offsets:
            start_ns, end_ns = chunk.message_start_time, chunk.message_end_time
            self.start_ns = start_ns if self.start_ns is None else min(self.start_ns, start_ns)
            self.end_ns = end_ns if self.end_ns is None else max(self.end_ns, end_ns)

    @property
    def is_indexed(self) -> bool:
        """Whether indexes cover every message: readers would miss the others, or refuse the file."""
        gaps = (c for c in self.chunks if c.message_end_time and not c.message_index_offsets)
        return not self.has_loose_messages and next(gaps, None) is None

    def statistics(self) -> Statistics:
        """Return the Statistics record."""
        return Statistics(
            message_count=self.message_counts.total(),
            schema_count=len(self.schemas),
            channel_count=len(self.channels),
            attachment_count=len(self.attachments),
            metadata_count=len(self.metadata),
            chunk_count=len(self.chunks),
            message_start_time=self.start_ns or 0,
            message_end_time=self.end_ns or 0,
            channel_message_counts=dict(sorted(self.message_counts.items())),
        )


def encode_records(records: Iterable[McapRecord]) -> bytes:
    """Encode records one after another."""
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    encoded: bytes = builder.end()  # type: ignore[no-untyped-call]
    return encoded


def encode_end(contents: Contents, position: int, data_crc: int) -> bytes:
    """Encode everything from the Data End record, at `position`, to the closing magic."""
    data_end = encode_records([DataEnd(data_crc)])
    summary_start = position + len(data_end)
    groups: list[tuple[Opcode, Iterable[McapRecord]]] = [
        (Opcode.SCHEMA, contents.schemas.values()),
        (Opcode.CHANNEL, contents.channels.values()),
        (Opcode.STATISTICS, [contents.statistics()]),
        (Opcode.CHUNK_INDEX, contents.chunks if contents.is_indexed else []),
        (Opcode.ATTACHMENT_INDEX, contents.attachments),
        (Opcode.METADATA_INDEX, contents.metadata),
    ]
    summary, offsets = bytearray(), []
    for opcode, records in groups:
        group = encode_records(records)
        if group:
            offsets.append(SummaryOffset(opcode, summary_start + len(summary), len(group)))
        summary += group
    offset_start = summary_start + len(summary)
    summary += encode_records(offsets)
    summary += encode_records([Footer(summary_start, offset_start, 0)])[:-_FOOTER_CRC_BYTES]
    return data_end + summary + zlib.crc32(summary).to_bytes(_FOOTER_CRC_BYTES, "little") + MAGIC
