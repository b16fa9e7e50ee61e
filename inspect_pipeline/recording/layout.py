"""Where everything lies in an MCAP file, and which channels it defines.

A chunk that the summary knows is stepped over together with its message indexes, so an indexed file costs one
small read per chunk; a file without summary, chunk index or chunks is scanned record by record. Nothing is
decompressed, except chunks that must be read for a channel that is defined nowhere else.
"""

from __future__ import annotations

from collections import Counter

from mcap.opcode import Opcode

from inspect_pipeline.recording.file import (
    RECORD_HEAD,
    Damage,
    Extent,
    RecordingFile,
    read_extent,
)
from inspect_pipeline.recording.scan import INDEX_HEAD, Layout, WrongIndexError, read_definitions, scan
from inspect_pipeline.recording.summary import MAGIC, Summary, read_summary

__all__ = ["Layout", "count_messages", "read_layout"]


def read_layout(file: RecordingFile) -> Layout:
    """Read the layout of an open MCAP file, however damaged. Raises Damage when it has no readable header."""
    if file.read(0, min(len(MAGIC), file.size_bytes)) != MAGIC:
        raise Damage("it is not an MCAP file" if file.size_bytes else "it is empty")
    summary = read_summary(file)
    try:
        layout = scan(file, summary)
    except WrongIndexError:
        summary = Summary(loss="its summary does not match its data, which were scanned instead")
        layout = scan(file, summary)
    if summary.loss and not layout.losses:
        layout.losses.append(summary.loss)
    layout.schemas = summary.schemas | layout.schemas
    layout.channels = summary.channels | layout.channels
    layout.statistics = summary.statistics
    _define_channels(file, layout)
    return layout


def count_messages(file: RecordingFile, extent: Extent) -> Counter[int]:
    """Messages per channel id of an extent, by its message indexes where it has them. Raises Damage."""
    if extent.counts is not None:
        return Counter(extent.counts)
    if extent.chunk is None or not extent.chunk.message_index_offsets:
        return read_definitions(read_extent(file, extent), {}, {})
    counts = Counter[int]()
    for channel_id, offset in extent.chunk.message_index_offsets.items():
        opcode, length = file.record_head(offset)
        if opcode != Opcode.MESSAGE_INDEX or length < INDEX_HEAD.size:
            raise Damage("a message index is not where the summary says")
        _, entries_bytes = INDEX_HEAD.unpack(file.read(offset + RECORD_HEAD.size, INDEX_HEAD.size))
        counts[channel_id] = entries_bytes // 16
    return counts


def _define_channels(file: RecordingFile, layout: Layout) -> None:
    """Read the chunks that hold channels or schemas which neither the summary nor loose records define."""
    for extent in layout.extents:
        if extent.chunk is None or _is_defined(extent, layout):
            continue
        try:
            extent.counts = read_definitions(read_extent(file, extent), layout.schemas, layout.channels)
        except Damage as damage:
            layout.losses.append(f"{damage} at byte {extent.offset:,}")


def _is_defined(extent: Extent, layout: Layout) -> bool:
    """Whether every channel of an extent is known, and the statistics count no more than are known."""
    ids = extent.channel_ids
    statistics = layout.statistics
    if ids is None or not ids <= layout.channels.keys():
        return False
    if statistics and statistics.channel_count > len(layout.channels):
        return False
    schema_ids = {layout.channels[i].schema_id for i in ids} - {0}
    return schema_ids <= layout.schemas.keys()
