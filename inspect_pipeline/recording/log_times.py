"""Unusual times of frames.

Log times far from all others, such as 0 before a clock was set or 2^64-1 from a faulty recorder, would
stretch a flight to decades, so frames that have one are set aside.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from typing import TYPE_CHECKING, NamedTuple, Protocol, TypeVar

import numpy as np

from inspect_pipeline.recording.file import Damage
from inspect_pipeline.recording.part import index_times

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from numpy.typing import NDArray

    from inspect_pipeline.recording.merge import PartExtent

_MAX_GAP_NS = 30 * 86_400 * 10**9  # no flight pauses for longer
_MIN_SHARE = 0.75  # of the messages; else it is not clear which times are the outliers


class Timed(Protocol):
    """A frame as far as its times go."""

    topic: str
    log_time_ns: int

    @property
    def stamp_ns(self) -> int: ...


_Timed = TypeVar("_Timed", bound=Timed)


class TimeRange(NamedTuple):
    """Log times with first_ns <= t <= last_ns."""

    first_ns: int = 0
    last_ns: int = (1 << 64) - 1

    def __contains__(self, time_ns: object) -> bool:
        return isinstance(time_ns, int) and self.first_ns <= time_ns <= self.last_ns


def usual_times(extents: Sequence[PartExtent], channel_ids: frozenset[int]) -> TimeRange:
    """Return the range with most log times of some channels; everything when there are no outliers.

    Messages are only looked at when the extents span more time than a flight can take.
    """
    starts, ends = ([getattr(e.extent, name) for e in extents] for name in ("start_ns", "end_ns"))
    if not extents or max(ends) - min(starts) <= _MAX_GAP_NS:
        return TimeRange()
    times = np.sort(_all_times(extents, channel_ids))
    gaps = np.flatnonzero(np.diff(times) > _MAX_GAP_NS) + 1
    largest = max(np.split(times, gaps), key=len)
    if len(largest) == len(times) or len(largest) < _MIN_SHARE * len(times):
        return TimeRange()
    return TimeRange(int(largest[0]), int(largest[-1]))


def _all_times(extents: Iterable[PartExtent], channel_ids: frozenset[int]) -> NDArray[np.uint64]:
    """Return the log times of all messages, from the message indexes where there are any."""
    found = [np.zeros(0, np.uint64)]
    for each in extents:
        wanted = [i for i, number in each.part.ids.items() if number in channel_ids]
        try:
            with each.part.open() as file:
                times = index_times(file, each.extent, wanted)
            if times is None:
                entries = each.entries(each.read(), channel_ids)
                times = np.array([time_ns for time_ns, _, _ in entries], np.uint64)
        except Damage:  # reported by whoever reads the messages
            continue
        found.append(times)
    return np.concatenate(found)


class FrameChecks:
    """Counts unusual times of frames, per topic.

    Viewers cannot match annotations to images by header stamps that are zero, repeated or out of order.
    """

    _ASIDE = "set aside: log times far from all others"
    _LATE = "out of log-time order: the recording states wrong times of its chunks"
    _NO_STAMP = "without a header stamp"
    _REPEATED = "with the header stamp of the one before"
    _BACKWARDS = "with a header stamp before that of the one before"

    def __init__(self) -> None:
        self._last_ns: dict[str, int] = {}
        self._last_log_ns: dict[str, int] = {}
        self._counts: defaultdict[str, Counter[str]] = defaultdict(Counter)

    def set_aside(self, topic: str) -> None:
        """Count a frame that is not yielded because its log time is an outlier."""
        self._counts[topic][self._ASIDE] += 1

    def checked(self, frames: Iterable[_Timed]) -> Iterator[_Timed]:
        """Iterate over the same frames, and check each."""
        for frame in frames:
            self.check(frame)
            yield frame

    def check(self, frame: Timed) -> None:
        """Compare the times of a frame with those of the one before."""
        topic, log_time_ns = frame.topic, frame.log_time_ns
        if log_time_ns < self._last_log_ns.get(topic, 0):
            self._counts[topic][self._LATE] += 1
        self._last_log_ns[topic] = max(log_time_ns, self._last_log_ns.get(topic, 0))
        before_ns, self._last_ns[frame.topic] = self._last_ns.get(frame.topic, -1), frame.stamp_ns
        if frame.stamp_ns == 0:
            self._counts[frame.topic][self._NO_STAMP] += 1
        elif frame.stamp_ns == before_ns:
            self._counts[frame.topic][self._REPEATED] += 1
        elif frame.stamp_ns < before_ns:
            self._counts[frame.topic][self._BACKWARDS] += 1

    def warnings(self) -> Iterator[str]:
        """Iterate over one phrase per kind and topic."""
        for topic, counts in sorted(self._counts.items()):
            for kind, count in counts.items():
                yield f"{topic}: {count:,} {'image' if count == 1 else 'images'} {kind}"
