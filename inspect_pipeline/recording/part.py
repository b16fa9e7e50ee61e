"""The MCAP files that a recording consists of.

Mostly there is one. A split recording has several, and so has a file that was made by appending one recording
to another (`cat a.mcap b.mcap`): then each part is a range of bytes of the file.
"""

from __future__ import annotations

from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Metadata

from inspect_pipeline.recording.file import RECORD_HEAD, Damage, RecordingFile, opened, read_extent, reading
from inspect_pipeline.recording.layout import INDEX_HEAD, WrongIndexError, read_definitions, scan
from inspect_pipeline.recording.summary import MAGIC, Summary, load_record, read_summary
from inspect_pipeline.recording.types import ChannelSummary

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence
    from contextlib import AbstractContextManager
    from pathlib import Path

    from numpy.typing import NDArray

    from inspect_pipeline.recording.file import Extent
    from inspect_pipeline.recording.layout import Layout

_BLOCK_BYTES = 1 << 20
_INDEX_ENTRY_BYTES = 16
_ChannelKey = tuple[str, str, tuple[str, str, bytes] | None]


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """One MCAP file of a recording: `size_bytes` of the file at `path` from the byte `start` on.

    file_bytes: size of the file. metadata: its Metadata records by name; of several with one name, the last.
    ids: the channel id in the recording by the channel id in this part.
    """

    path: Path
    start: int
    size_bytes: int
    file_bytes: int
    layout: Layout
    metadata: Mapping[str, Mapping[str, str]]
    ids: Mapping[int, int] = field(default_factory=dict)

    def open(self) -> AbstractContextManager[RecordingFile]:
        """Open the part as `opened` does; offsets count from its first byte."""
        return opened(self.path, self.start, self.size_bytes)


def open_parts(path: Path) -> Iterator[Part]:
    """Read the layout of each part of a file. Raises RecordingError when it is not an MCAP file."""
    start: int | None = 0
    while start is not None:
        with reading(path, start) as file:
            part, following = _open_part(path, file)
        yield part
        start = following


def _open_part(path: Path, file: RecordingFile) -> tuple[Part, int | None]:
    """Read the part at the start of `file`; also return where in the file at `path` the next one begins."""
    layout, following = read_layout(file), None
    end, file_bytes = layout.end, file.start + file.size_bytes
    if end < file.size_bytes:  # its summary is not at the end of the file
        with reading(path, file.start, end) as shorter:
            layout = read_layout(shorter)
        next_at = _skip_zeros(file, end)
        if file.read(next_at, min(len(MAGIC), file.size_bytes - next_at)) == MAGIC:
            following = file.start + next_at
        elif next_at < file.size_bytes:
            n_left = file.size_bytes - next_at
            layout.losses.append(f"{n_left:,} bytes after its end are not part of a recording")
    metadata = _read_metadata(file, layout)
    return Part(path, file.start, end, file_bytes, layout, metadata), following


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


def _define_channels(file: RecordingFile, layout: Layout) -> None:
    """Read the chunks with channels or schemas that neither the summary nor records outside chunks define."""
    for extent in layout.extents:
        if extent.chunk is None or _is_defined(extent, layout):
            continue
        try:
            extent.counts = read_definitions(read_extent(file, extent), layout.schemas, layout.channels)
        except Damage as damage:
            layout.losses.append(f"{damage} at byte {extent.offset:,}")


def _is_defined(extent: Extent, layout: Layout) -> bool:
    """Whether all channels of an extent are known, and no others by the statistics."""
    ids = extent.channel_ids
    statistics = layout.statistics
    if ids is None or not ids <= layout.channels.keys():
        return False
    if statistics and statistics.channel_count > len(layout.channels):
        return False
    schema_ids = {layout.channels[i].schema_id for i in ids} - {0}
    return schema_ids <= layout.schemas.keys()


def _skip_zeros(file: RecordingFile, at: int) -> int:
    """Return the offset of the first byte from `at` on that is not zero: some recorders pad."""
    while at < file.size_bytes:
        block = file.read(at, min(_BLOCK_BYTES, file.size_bytes - at))
        stripped = block.lstrip(b"\0")
        at += len(block) - len(stripped)
        if stripped:
            break
    return at


def _read_metadata(file: RecordingFile, layout: Layout) -> dict[str, dict[str, str]]:
    metadata = {}
    for index in layout.metadata:
        try:
            record = load_record(file, Metadata, index.offset)
        except Damage as damage:
            layout.losses.append(f"{damage} at byte {index.offset:,}")
            continue
        metadata[record.name] = record.metadata
    return metadata


def count_messages(file: RecordingFile, extent: Extent) -> Counter[int]:
    """Count the messages of an extent per channel id, by its message indexes if it has any. Raises Damage."""
    if extent.counts is not None:
        return Counter(extent.counts)
    if extent.chunk is None or not extent.chunk.message_index_offsets:
        return read_definitions(read_extent(file, extent), {}, {})
    counts = Counter[int]()
    for channel_id, offset in extent.chunk.message_index_offsets.items():
        counts[channel_id] = _entries_bytes(file, offset) // _INDEX_ENTRY_BYTES
    return counts


def index_times(file: RecordingFile, extent: Extent, channel_ids: Iterable[int]) -> NDArray[np.uint64] | None:
    """Return the log times of an extent's messages by its message indexes, None when it has none.

    Raises Damage.
    """
    if extent.chunk is None or not extent.chunk.message_index_offsets:
        return None
    offsets = extent.chunk.message_index_offsets
    indexes = [
        file.read(at + RECORD_HEAD.size + INDEX_HEAD.size, _entries_bytes(file, at))
        for at in (offsets[i] for i in channel_ids if i in offsets)
    ]
    return np.frombuffer(b"".join(indexes), "<u8")[::2]  # log time, offset, log time, offset, ...


def _entries_bytes(file: RecordingFile, offset: int) -> int:
    """Return the size of the entries of the Message Index record at `offset`. Raises Damage."""
    opcode, length = file.record_head(offset)
    if opcode != Opcode.MESSAGE_INDEX or length < INDEX_HEAD.size:
        raise Damage("a message index is not where the summary says")
    _, entries_bytes = INDEX_HEAD.unpack(file.read(offset + RECORD_HEAD.size, INDEX_HEAD.size))
    if entries_bytes % _INDEX_ENTRY_BYTES or entries_bytes > length - INDEX_HEAD.size:
        raise Damage("a message index has another size than it says")
    return int(entries_bytes)


def part_counts(part: Part) -> Counter[int]:
    """Count the messages of a part by its channel ids; those of unreadable chunks are not counted."""
    if part.layout.statistics is not None:
        return Counter(part.layout.statistics.channel_message_counts)
    counts = Counter[int]()
    with part.open() as file:
        for extent in part.layout.extents:
            with suppress(Damage):
                counts += count_messages(file, extent)
    return counts


def number_channels(parts: Sequence[Part]) -> tuple[Part, ...]:
    """Give the channels of one topic, encoding and schema the same id in all parts.

    In a single part they keep their own, else they are numbered from 1 in the order of their topics.
    """
    if len(parts) == 1:
        return (replace(parts[0], ids={i: i for i in parts[0].layout.channels}),)
    keys = [{i: _channel_key(part, i) for i in part.layout.channels} for part in parts]
    in_order = sorted({key for each in keys for key in each.values()}, key=lambda key: (key[0], repr(key)))
    numbers = {key: number for number, key in enumerate(in_order, 1)}
    return tuple(
        replace(part, ids={i: numbers[key] for i, key in each.items()})
        for part, each in zip(parts, keys, strict=True)
    )


def _channel_key(part: Part, channel_id: int) -> _ChannelKey:
    channel = part.layout.channels[channel_id]
    schema = part.layout.schemas.get(channel.schema_id)
    declared = (schema.name, schema.encoding, schema.data) if schema else None
    return channel.topic, channel.message_encoding, declared


def summarize_channels(parts: Sequence[Part]) -> tuple[ChannelSummary, ...]:
    """Describe the channels of all parts together, in the order of their topics."""
    summaries: dict[int, ChannelSummary] = {}
    for part in parts:
        counts = part_counts(part) if _is_countable(part) else None
        for i, channel in part.layout.channels.items():
            schema = part.layout.schemas.get(channel.schema_id)
            n, before = counts[i] if counts is not None else None, summaries.get(part.ids[i])
            if before:
                n = None if n is None or before.message_count is None else n + before.message_count
            summaries[part.ids[i]] = ChannelSummary(
                channel_id=part.ids[i],
                topic=channel.topic,
                schema_name=schema.name if schema else "",
                schema_encoding=schema.encoding if schema else "",
                message_encoding=channel.message_encoding,
                message_count=n,
                metadata=channel.metadata,
            )
    return tuple(sorted(summaries.values(), key=lambda channel: (channel.topic, channel.channel_id)))


def _is_countable(part: Part) -> bool:
    """Whether statistics or indexes say how many messages there are, without reading them."""
    return part.layout.statistics is not None or all(e.channel_ids is not None for e in part.layout.extents)
