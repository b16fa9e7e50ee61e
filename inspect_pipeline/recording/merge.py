"""Messages of a recording in log-time order, with memory bounded whatever the order in its files.

Extents are opened by their start time and their messages merged through a heap, so a recording in order
needs one extent at a time, and overlapping chunks or parts only those that overlap. Records wait in a cache
of fixed size; what falls out of it is read again.
"""

from __future__ import annotations

from array import array
from collections import OrderedDict
from heapq import heappop, heappush
from typing import TYPE_CHECKING, NamedTuple

from inspect_pipeline.errors import RecordingError
from inspect_pipeline.recording.file import MESSAGE_HEAD, Damage, Extent, message_entries, read_extent

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from inspect_pipeline.recording.part import Part

_CACHE_BYTES = 64 << 20


class Message(NamedTuple):
    """A Message record. `data` is a view into its extent's records and keeps them alive."""

    channel_id: int
    log_time_ns: int
    publish_time_ns: int
    data: memoryview


class PartExtent(NamedTuple):
    """An extent, and the part of the recording that it lies in, of which it is the `number`-th."""

    number: int
    part: Part
    extent: Extent

    @property
    def key(self) -> tuple[int, int]:
        """The position in the recording: number of the part, offset in it."""
        return self.number, self.extent.offset

    @property
    def channel_ids(self) -> frozenset[int] | None:
        """The channels of the recording with messages here; None when that is only known after reading."""
        ids = self.extent.channel_ids
        return None if ids is None else frozenset(self.part.ids[i] for i in ids if i in self.part.ids)

    def read(self) -> bytes:
        """Read the records. Raises Damage, RecordingError when the file cannot be opened."""
        with self.part.open() as file:
            return read_extent(file, self.extent)

    def entries(self, records: bytes, channel_ids: frozenset[int]) -> list[tuple[int, int, int]]:
        """`message_entries` of channels of the recording. Raises Damage."""
        wanted = frozenset(of_part for of_part, i in self.part.ids.items() if i in channel_ids)
        return message_entries(records, wanted)


def merge_messages(
    extents: Iterable[PartExtent],
    channel_ids: frozenset[int],
    on_loss: Callable[[PartExtent, Damage], None],
) -> Iterator[Message]:
    """Iterate over messages of `channel_ids` in log-time order, ties by part and position in its file.

    An extent that cannot be read is passed to `on_loss` and skipped. Raises RecordingError when a file cannot
    be opened, or changes while it is read.
    """
    merge = _Merge(channel_ids)
    for extent in sorted(extents, key=lambda each: (each.extent.start_ns, each.key)):
        yield from merge.before(extent.extent.start_ns)
        try:
            merge.open(extent)
        except Damage as damage:
            on_loss(extent, damage)
    yield from merge.before(None)


class _Merge:
    """The open extents: a heap with the next message of each, and the records of those used last."""

    def __init__(self, channel_ids: frozenset[int]) -> None:
        self._channel_ids = channel_ids
        self._cache = _RecordsCache()
        # A heap: log time, key of the extent, start and end of the message's body.
        self._next: list[tuple[int, tuple[int, int], int, int]] = []
        self._open: dict[tuple[int, int], tuple[PartExtent, Iterator[tuple[int, int, int]]]] = {}

    def open(self, extent: PartExtent) -> None:
        """Add the messages of an extent. Raises Damage."""
        entries = sorted(extent.entries(self._cache.records(extent), self._channel_ids))
        # All extents are open at once where all overlap, so a message takes only 16 bytes.
        columns = (
            array(code, column) for code, column in zip("QII", zip(*entries, strict=True), strict=False)
        )
        self._open[extent.key] = (extent, zip(*columns, strict=True))
        self._advance(extent.key)

    def before(self, end_ns: int | None) -> Iterator[Message]:
        """Take the waiting messages with log time < end_ns (None: all of them), in order."""
        while self._next and (end_ns is None or self._next[0][0] < end_ns):
            yield self._pop()

    def _pop(self) -> Message:
        _, key, start, end = heappop(self._next)
        extent = self._open[key][0]
        try:
            records = self._cache.records(extent)
        except Damage as damage:  # it was read before
            raise RecordingError(extent.part.path, str(damage), "copy it again") from damage
        self._advance(key)
        channel_id, _, log_time_ns, publish_time_ns = MESSAGE_HEAD.unpack_from(records, start)
        data = memoryview(records)[start + MESSAGE_HEAD.size : end]
        return Message(extent.part.ids[channel_id], log_time_ns, publish_time_ns, data)

    def _advance(self, key: tuple[int, int]) -> None:
        """Put the next message of an extent into the heap; close the extent after its last one."""
        entry = next(self._open[key][1], None)
        if entry:
            log_time_ns, start, end = entry
            heappush(self._next, (log_time_ns, key, start, end))
        else:
            del self._open[key]
            self._cache.drop(key)


class _RecordsCache:
    """The records of the extents used last: at most `_CACHE_BYTES`, but always one extent."""

    def __init__(self) -> None:
        self._held: OrderedDict[tuple[int, int], bytes] = OrderedDict()
        self._size_bytes = 0

    def records(self, extent: PartExtent) -> bytes:
        held = self._held.get(extent.key)
        if held is not None:
            self._held.move_to_end(extent.key)
            return held
        records = extent.read()
        self._held[extent.key] = records
        self._size_bytes += len(records)
        while self._size_bytes > _CACHE_BYTES and len(self._held) > 1:
            self._size_bytes -= len(self._held.popitem(last=False)[1])
        return records

    def drop(self, key: tuple[int, int]) -> None:
        self._size_bytes -= len(self._held.pop(key, b""))
