"""The MCAP files that a recording consists of.

Mostly there is one. A split recording has several, and so has a file that was made by writing one recording
behind another (`cat a.mcap b.mcap`): there each part is a range of bytes of the file.
"""

from __future__ import annotations

from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from mcap.records import Metadata

from inspect_pipeline.recording.file import Damage, RecordingFile, opened, reading
from inspect_pipeline.recording.layout import count_messages, read_layout
from inspect_pipeline.recording.summary import MAGIC, load_record
from inspect_pipeline.recording.types import ChannelSummary

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from contextlib import AbstractContextManager
    from pathlib import Path

    from inspect_pipeline.recording.layout import Layout

_BLOCK_BYTES = 1 << 20
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
            )
    return tuple(sorted(summaries.values(), key=lambda channel: (channel.topic, channel.channel_id)))


def _is_countable(part: Part) -> bool:
    """Whether statistics or indexes say how many messages there are, without reading them."""
    return part.layout.statistics is not None or all(e.channel_ids is not None for e in part.layout.extents)
