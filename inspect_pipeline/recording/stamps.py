"""Header stamps by which viewers cannot match annotations to images: zero, repeated, out of order."""

from __future__ import annotations

from collections import Counter, defaultdict
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

    from inspect_pipeline.recording.types import Frame

_NO_STAMP = "images without a header stamp"
_REPEATED = "images with the header stamp of the one before"
_BACKWARDS = "images with a header stamp before that of the one before"


class StampCheck:
    """Takes frames in log-time order and counts what is odd about their stamps, per topic."""

    def __init__(self) -> None:
        self._last_ns: dict[str, int] = {}
        self._counts: defaultdict[str, Counter[str]] = defaultdict(Counter)

    def see(self, frame: Frame) -> None:
        """Take note of a frame. One whose message could not be taken apart has no stamp to speak of."""
        before_ns, self._last_ns[frame.topic] = self._last_ns.get(frame.topic, -1), frame.stamp_ns
        if frame.stamp_ns == 0:
            self._counts[frame.topic][_NO_STAMP] += 1
        elif frame.stamp_ns == before_ns:
            self._counts[frame.topic][_REPEATED] += 1
        elif frame.stamp_ns < before_ns:
            self._counts[frame.topic][_BACKWARDS] += 1

    def warnings(self) -> Iterator[str]:
        """One phrase per kind and topic."""
        for topic, counts in sorted(self._counts.items()):
            for kind, count in counts.items():
                yield f"{topic}: {count:,} {kind}"
