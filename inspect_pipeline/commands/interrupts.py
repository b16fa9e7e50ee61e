"""What SIGINT (Ctrl-C) and SIGTERM do to a command: it stops, cleans up, and exits with 130 or 143."""

from __future__ import annotations

import os
import signal
import sys
import threading
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, NoReturn

import typer

if TYPE_CHECKING:
    from collections.abc import Iterator
    from types import FrameType

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_received: list[int] = []


def install_handlers() -> None:
    """Let both signals end the program as an exception does, so that what was begun is removed."""
    _received.clear()
    for number in _SIGNALS:
        signal.signal(number, _stop)


def exit_if_stopped() -> None:
    """End the program if a signal was received, whatever exception it became on the way up."""
    if _received:
        exit_at_once(_received[0])


@contextmanager
def stop_after_block() -> Iterator[None]:
    """Delay a stop to the end of the block; a second signal ends the program at once.

    For the import of torch and OpenVINO, whose C++ aborts when a Python exception passes through it.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    received: list[int] = []

    def note(signal_number: int, _frame: FrameType | None) -> None:
        if received:
            exit_at_once(signal_number)
        received.append(signal_number)

    before = [signal.signal(number, note) for number in _SIGNALS]
    try:
        yield
    finally:
        for number, handler in zip(_SIGNALS, before, strict=True):
            signal.signal(number, handler)
        if received:
            _stop(received[0], None)


def exit_at_once(signal_number: int) -> NoReturn:
    """Say so and exit, without the teardown of Python: threads of C++ libraries abort in it."""
    with suppress(OSError, ValueError):  # a reader that left
        typer.echo(
            "stopped: interrupted" if signal_number == signal.SIGINT else "stopped: terminated", err=True
        )
        sys.stdout.flush()
    os._exit(128 + signal_number)


def _stop(signal_number: int, _frame: FrameType | None) -> None:
    _received.append(signal_number)
    sys.exit(128 + signal_number)
