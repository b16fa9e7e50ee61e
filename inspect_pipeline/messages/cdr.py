"""ROS messages, read and written field by field: CDR of ROS 2, and the serialization of ROS 1.

Our own because only a few leading fields of each message are needed: an image message is parsed without
copying its data, 2.4 times as fast as by rosbags.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, ClassVar

import numpy as np

if TYPE_CHECKING:
    from inspect_pipeline.arrays import RealArray

_HEADER_BYTES = 4
_LITTLE_ENDIAN = b"\0\1\0\0"
_MAX_SECONDS = 2**31 - 1  # builtin_interfaces/Time has int32 seconds, which end in 2038


class SequentialReader:
    """Reads the fields of a message in their order; the base of both ROS encodings.

    Every method raises ValueError or struct.error when its field reaches beyond the end of the message.
    """

    _start: ClassVar[int]  # offset of the first field
    _max_alignment: ClassVar[int]  # numbers are aligned to their size, at most to this

    def __init__(self, payload: memoryview) -> None:
        self._payload = payload
        self._at = self._start
        self._order = "<"

    def int8(self) -> int:
        """Read a signed byte."""
        return int(self.number("b"))

    def uint8(self) -> int:
        """Read a byte."""
        return int(self.number("B"))

    def uint16(self) -> int:
        """Read an unsigned number of two bytes."""
        return int(self.number("H"))

    def uint32(self) -> int:
        """Read an unsigned number of four bytes."""
        return int(self.number("I"))

    def float64(self) -> float:
        """Read a double."""
        return self.number("d")

    def float64s(self, count: int | None = None) -> tuple[float, ...]:
        """Read an array of `count` doubles, or by default a sequence, which begins with its length."""
        return self.numbers("d", self.uint32() if count is None else count)

    def blob(self) -> memoryview:
        """Read a sequence of bytes, without copying it."""
        length = self.uint32()
        start, self._at = self._at, self._at + length
        if self._at > len(self._payload):
            raise ValueError("a field reaches beyond the end of the message")
        return self._payload[start : self._at]

    def string(self) -> str:
        """Read a string, with or without a terminating zero."""
        return bytes(self.blob()).rstrip(b"\0").decode()

    def time_ns(self) -> int:
        """Read a builtin_interfaces/Time."""
        return self.uint32() * 1_000_000_000 + self.uint32()

    def header(self) -> tuple[int, str]:
        """Read a std_msgs/Header: (stamp in nanoseconds, frame_id)."""
        return self.time_ns(), self.string()

    @property
    def n_bytes(self) -> int:
        """Size of the message."""
        return len(self._payload)

    def numbers(self, code: str, count: int) -> tuple[float, ...]:
        """Read `count` numbers of one format character of `struct`."""
        size = struct.calcsize("<" + code)
        if count * size > len(self._payload):
            raise ValueError("a field reaches beyond the end of the message")
        if count == 0:
            return ()
        first = self.number(code)
        values = struct.unpack_from(f"{self._order}{count - 1}{code}", self._payload, self._at)
        self._at += (count - 1) * size
        return (first, *values)

    def number(self, code: str) -> float:
        """Read a number by its format character of `struct`."""
        size = struct.calcsize("<" + code)
        self._at += -(self._at - self._start) % min(size, self._max_alignment)
        value: float = struct.unpack_from(self._order + code, self._payload, self._at)[0]
        self._at += size
        return value


class CdrReader(SequentialReader):
    """Reads a ROS 2 message: XCDR1 behind a header of 4 bytes, the second of which is the byte order."""

    _start = _HEADER_BYTES
    _max_alignment = 8

    def __init__(self, payload: memoryview) -> None:
        super().__init__(payload)
        self._order = "<" if payload[1] & 1 else ">"


class Ros1Reader(SequentialReader):
    """Reads a ROS 1 message: little-endian, without alignment."""

    _start = 0
    _max_alignment = 1

    def header(self) -> tuple[int, str]:
        """Read a std_msgs/Header, which in ROS 1 begins with a sequence number."""
        self.uint32()
        return super().header()


class CdrWriter:
    """Builds a ROS 2 message; numbers are aligned to their size, counted from the end of the CDR header."""

    def __init__(self) -> None:
        self._body = bytearray()

    def number(self, code: str, value: float) -> None:
        """Append a number by its format character of `struct`."""
        self._align(struct.calcsize("<" + code))
        self._body += struct.pack("<" + code, value)

    def header(self, time_ns: int, frame_id: str) -> None:
        """Append a std_msgs/Header."""
        self.time(time_ns)
        self.text(frame_id)

    def blob(self, data: bytes) -> None:
        """Append a sequence of bytes."""
        self.number("I", len(data))
        self._body += data

    def text(self, value: str) -> None:
        """Append a string."""
        encoded = value.encode() + b"\0"
        self.number("I", len(encoded))
        self._body += encoded

    def time(self, time_ns: int) -> None:
        """Append a builtin_interfaces/Time."""
        seconds, nanoseconds = divmod(time_ns, 1_000_000_000)
        self.number("i", min(seconds, _MAX_SECONDS))
        self.number("I", nanoseconds)

    def numbers(self, values: RealArray, dtype: str) -> None:
        """Append an array of numbers of one type."""
        if values.size:
            self._align(np.dtype(dtype).itemsize)
            self._body += values.astype(dtype).tobytes()

    def sequence(self, rows: RealArray, dtype: str) -> None:
        """Append a sequence of N messages that have k numbers of one type each: (N, k)."""
        self.number("I", len(rows))
        self.numbers(rows, dtype)

    def finish(self) -> bytes:
        """Return the message."""
        return _LITTLE_ENDIAN + bytes(self._body)

    def _align(self, size: int) -> None:
        self._body += bytes(-len(self._body) % size)
