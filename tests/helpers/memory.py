"""Peaks of the memory of this process.

Those of getrusage include what was before: of other tests in the process, or of the process that started it.
"""

from __future__ import annotations

from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator


@contextmanager
def grows_by_less_than(limit_mb: int) -> Iterator[None]:
    """Fail where the peak within is this much above the memory before."""
    Path("/proc/self/clear_refs").write_text("5")  # reset the peak
    before_kib = _memory_kib("VmRSS")
    yield
    grown_mb = (peak_kib() - before_kib) >> 10
    assert grown_mb < limit_mb


def peak_kib() -> int:
    """The peak since the program was started, or the last reset."""
    return _memory_kib("VmHWM")


def _memory_kib(key: str) -> int:
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(key))
