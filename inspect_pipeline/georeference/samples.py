"""Values over time, up to a few thousand a second."""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from inspect_pipeline.arrays import Floats


class PoseSample(NamedTuple):
    """Values at a time, and their age."""

    values: list[float]
    age_ms: float


@dataclass(frozen=True, slots=True, eq=False)
class PoseSamples:
    """Values over time: times_ns (N,) uint64 in order, values (N, k) float64."""

    times_ns: NDArray[np.uint64] = field(default_factory=lambda: np.zeros(0, np.uint64))
    values: Floats = field(default_factory=lambda: np.zeros((0, 0)))

    def __len__(self) -> int:
        return len(self.times_ns)

    def last_at(self, time_ns: int) -> PoseSample | None:
        """Return the last sample that is not after `time_ns`."""
        i = int(np.searchsorted(self.times_ns, np.uint64(time_ns), side="right")) - 1
        if i < 0:
            return None
        return PoseSample(self.values[i].tolist(), (time_ns - int(self.times_ns[i])) / 1e6)


class SampleRows:
    """Collects samples in compact arrays."""

    def __init__(self) -> None:
        self._times_ns, self._values = array("Q"), array("d")

    def append(self, time_ns: int, *values: float) -> None:
        """Append a sample."""
        self._times_ns.append(time_ns)
        self._values.extend(values)

    def to_samples(self) -> PoseSamples:
        """Return the samples in the order in which they were added."""
        if not self._times_ns:
            return PoseSamples()
        times_ns = np.frombuffer(self._times_ns, np.uint64)
        return PoseSamples(times_ns, np.frombuffer(self._values, np.float64).reshape(len(times_ns), -1))


def longest(candidates: Iterable[PoseSamples]) -> PoseSamples:
    """Return the one with the most samples: mixing two receivers would make positions jump."""
    return max(candidates, key=len, default=PoseSamples())
