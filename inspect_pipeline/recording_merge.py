"""Messages of a recording in log-time order, with memory bounded whatever the order in the file.

Extents are opened by their start time and their messages merged through a heap, so a file in order needs
one extent at a time, and overlapping chunks only those that overlap. Records wait in a cache of fixed
size; what falls out of it is read again.
"""

from __future__ import annotations

from collections import OrderedDict
from heapq import heappop, heappush
from typing import TYPE_CHECKING, NamedTuple

from inspect_pipeline.recording_extents import (
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
    """The open extents: a heap of their waiting messages, and the records of those used last."""

    def __init__(self, file: RecordingFile, channel_ids: frozenset[int]) -> None:
        self._channel_ids = channel_ids
        self._cache = _RecordsCache(file)
        self._waiting: list[tuple[int, int, int, int]] = []  # log time, extent's offset, body's start, end
        self._open: dict[int, tuple[Extent, int]] = {}  # by offset: extent, number of messages waiting

    def open(self, extent: Extent) -> None:
        entries = message_entries(self._cache.records(extent), self._channel_ids)
        for log_time_ns, start, end in entries:
            heappush(self._waiting, (log_time_ns, extent.offset, start, end))
        if entries:
            self._open[extent.offset] = (extent, len(entries))
        else:
            self._cache.drop(extent)

    def before(self, end_ns: int | None) -> Iterator[Message]:
        """Take the waiting messages with log time < end_ns (None: all of them), in order."""
        while self._waiting and (end_ns is None or self._waiting[0][0] < end_ns):
            yield self._pop()

    def _pop(self) -> Message:
        _, offset, start, end = heappop(self._waiting)
        extent, n_waiting = self._open.pop(offset)
        records = self._cache.records(extent)
        if n_waiting > 1:
            self._open[offset] = (extent, n_waiting - 1)
        else:
            self._cache.drop(extent)
        channel_id, _, log_time_ns, publish_time_ns = MESSAGE_HEAD.unpack_from(records, start)
        data = memoryview(records)[start + MESSAGE_HEAD.size : end]
        return Message(channel_id, log_time_ns, publish_time_ns, data)


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
