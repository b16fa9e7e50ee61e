"""A request to stop, made by a signal."""

from __future__ import annotations

import signal
import sys
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator
    from types import FrameType

_POLL_S = 0.5
_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class StopRequest:
    """Whether to stop, and with which exit code."""

    def __init__(self) -> None:
        self.exit_code: int | None = None

    def is_made(self) -> bool:
        """Whether a stop was requested."""
        return self.exit_code is not None

    def wait(self, seconds: float) -> None:
        """Sleep, or until a stop is requested."""
        end = time.monotonic() + seconds
        while not self.is_made() and (left := end - time.monotonic()) > 0:
            time.sleep(min(left, _POLL_S))

    def _note(self, signal_number: int, _frame: FrameType | None) -> None:
        if self.is_made():  # the second signal
            sys.exit(self.exit_code)
        self.exit_code = 128 + signal_number


@contextmanager
def stop_on_signals() -> Iterator[StopRequest]:
    """Yield a request that the first SIGINT or SIGTERM makes; the second one ends the program."""
    request = StopRequest()
    before = [signal.signal(number, request._note) for number in _SIGNALS]
    try:
        yield request
    finally:
        for number, handler in zip(_SIGNALS, before, strict=True):
            signal.signal(number, handler)
