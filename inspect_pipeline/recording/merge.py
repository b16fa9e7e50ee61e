"""Messages of a recording in log-time order, with memory bounded whatever the order in the file.

Extents are opened by their start time and their messages merged through a heap, so a file in order needs
one extent at a time, and overlapping chunks only those that overlap. Records wait in a cache of fixed
size; what falls out of it is read again.
"""

from __future__ import annotations

from array import array
from collections import OrderedDict
from heapq import heappop, heappush
from typing import TYPE_CHECKING, NamedTuple

from inspect_pipeline.recording.file import (
    MESSAGE_HEAD,
    Damage,
    Extent,
    RecordingFile,
    message_entries,
    read_extent,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

_CACHE_BYTES = 64 << 20


class Message(NamedTuple):
    """A Message record. `data` is a view into its extent's records and keeps them alive."""

    channel_id: int
    log_time_ns: int
    publish_time_ns: int
    data: memoryview


def iter_messages(
    file: RecordingFile,
    extents: Iterable[Extent],
    channel_ids: frozenset[int],
    on_loss: Callable[[Extent, Damage], None],
) -> Iterator[Message]:
    """Messages of `channel_ids` in log-time order, ties by position in the file.

    An extent that cannot be read is reported to `on_loss` and passed over. Raises Damage when the file
    changes while it is read.
    """
    merge = _Merge(file, channel_ids)
    for extent in sorted(extents, key=lambda extent: (extent.start_ns, extent.offset)):
        yield from merge.before(extent.start_ns)
        try:
            merge.open(extent)
        except Damage as damage:
            on_loss(extent, damage)
    yield from merge.before(None)


class _Merge:
    """The open extents: a heap with the next message of each, and the records of those used last."""

    def __init__(self, file: RecordingFile, channel_ids: frozenset[int]) -> None:
        self._channel_ids = channel_ids
        self._cache = _RecordsCache(file)
        self._next: list[tuple[int, int, int, int]] = []  # heap: log time, extent's offset, body's start, end
        self._open: dict[int, tuple[Extent, Iterator[tuple[int, int, int]]]] = {}  # by offset

    def open(self, extent: Extent) -> None:
        entries = sorted(message_entries(self._cache.records(extent), self._channel_ids))
        # Where every chunk overlaps every other all are open at once: 16 bytes a message.
        columns = (
            array(code, column) for code, column in zip("QII", zip(*entries, strict=True), strict=False)
        )
        self._open[extent.offset] = (extent, zip(*columns, strict=True))
        self._advance(extent.offset)

    def before(self, end_ns: int | None) -> Iterator[Message]:
        """Take the waiting messages with log time < end_ns (None: all of them), in order."""
        while self._next and (end_ns is None or self._next[0][0] < end_ns):
            yield self._pop()

    def _pop(self) -> Message:
        _, offset, start, end = heappop(self._next)
        records = self._cache.records(self._open[offset][0])
        self._advance(offset)
        channel_id, _, log_time_ns, publish_time_ns = MESSAGE_HEAD.unpack_from(records, start)
        data = memoryview(records)[start + MESSAGE_HEAD.size : end]
        return Message(channel_id, log_time_ns, publish_time_ns, data)

    def _advance(self, offset: int) -> None:
        """Put the next message of an extent into the heap; close it after its last."""
        extent, coming = self._open[offset]
        entry = next(coming, None)
        if entry:
            log_time_ns, start, end = entry
            heappush(self._next, (log_time_ns, offset, start, end))
        else:
            del self._open[offset]
            self._cache.drop(extent)


class _RecordsCache:
    """The records of the extents used last: at most `_CACHE_BYTES`, but always one extent."""

    def __init__(self, file: RecordingFile) -> None:
        self._file = file
        self._held: OrderedDict[int, bytes] = OrderedDict()
        self._size_bytes = 0

    def records(self, extent: Extent) -> bytes:
        held = self._held.get(extent.offset)
        if held is not None:
            self._held.move_to_end(extent.offset)
            return held
        records = read_extent(self._file, extent)
        self._held[extent.offset] = records
        self._size_bytes += len(records)
        while self._size_bytes > _CACHE_BYTES and len(self._held) > 1:
            self._size_bytes -= len(self._held.popitem(last=False)[1])
        return records

    def drop(self, extent: Extent) -> None:
        self._size_bytes -= len(self._held.pop(extent.offset, b""))
