"""Messages of ROS 2 written: the counterpart of `wire.CdrReader`."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from inspect_pipeline.arrays import RealArray

_LITTLE_ENDIAN = b"\0\1\0\0"
_MAX_SECONDS = 2**31 - 1


class CdrWriter:
    """Builds a message of XCDR1: numbers are aligned to their size, counted from behind the head."""

    def __init__(self) -> None:
        self._body = bytearray()

    def number(self, code: str, value: float) -> None:
        """A number by its code in `struct`."""
        self._align(struct.calcsize("<" + code))
        self._body += struct.pack("<" + code, value)

    def header(self, time_ns: int, frame_id: str) -> None:
        """A std_msgs/Header."""
        self.time(time_ns)
        self.text(frame_id)

    def blob(self, data: bytes) -> None:
        """A sequence of bytes."""
        self.number("I", len(data))
        self._body += data

    def text(self, value: str) -> None:
        """A string, with its length and a terminating zero."""
        encoded = value.encode() + b"\0"
        self.number("I", len(encoded))
        self._body += encoded

    def time(self, time_ns: int) -> None:
        """A builtin_interfaces/Time; its seconds end in 2038."""
        seconds, nanoseconds = divmod(time_ns, 1_000_000_000)
        self.number("i", min(seconds, _MAX_SECONDS))
        self.number("I", nanoseconds)

    def numbers(self, values: RealArray, dtype: str) -> None:
        """Numbers of one type, one after another."""
        if values.size:
            self._align(np.dtype(dtype).itemsize)
            self._body += values.astype(dtype).tobytes()

    def sequence(self, rows: RealArray, dtype: str) -> None:
        """A sequence of messages made of numbers of one type: (N, number of fields)."""
        self.number("I", len(rows))
        self.numbers(rows, dtype)

    def finish(self) -> bytes:
        """The message."""
        return _LITTLE_ENDIAN + bytes(self._body)

    def _align(self, size: int) -> None:
        self._body += bytes(-len(self._body) % size)
