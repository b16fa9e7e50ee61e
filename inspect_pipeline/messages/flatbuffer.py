"""Fields read from messages of ROS and FlatBuffers without their packages: what images and poses need.

Readers raise one of MALFORMED when a message is not what it should be.
"""

from __future__ import annotations

import struct
from typing import ClassVar

from google.protobuf.message import DecodeError

# What reading fields from a message of any encoding can raise, JSON and protobuf included.
MALFORMED = (
    ValueError,
    LookupError,
    TypeError,
    AttributeError,
    ArithmeticError,
    RecursionError,
    struct.error,
    DecodeError,
)


class SequentialReader:
    """Reads the fields of a message one after another; the base of both ROS encodings."""

    _start: ClassVar[int]  # where the fields begin
    _alignment: ClassVar[int]  # the most that a number is aligned to, counted from there

    def __init__(self, payload: memoryview) -> None:
        self._payload = payload
        self._at = self._start
        self._order = "<"

    def uint8(self) -> int:
        """One byte."""
        return int(self.number("B"))

    def uint32(self) -> int:
        """Four bytes."""
        return int(self.number("I"))

    def int8(self) -> int:
        """One byte with a sign."""
        return int(self.number("b"))

    def uint16(self) -> int:
        """Two bytes."""
        return int(self.number("H"))

    def float64(self) -> float:
        """A double."""
        return self.number("d")

    def float64s(self, count: int | None = None) -> tuple[float, ...]:
        """`count` doubles, or a sequence of them with its length before it."""
        length = self.uint32() if count is None else count
        if 8 * length > len(self._payload):
            raise ValueError("a field overruns the message")
        return tuple(self.float64() for _ in range(length))

    def blob(self) -> memoryview:
        """A sequence of bytes with its length before it."""
        length = self.uint32()
        start, self._at = self._at, self._at + length
        if self._at > len(self._payload):
            raise ValueError("a field overruns the message")
        return self._payload[start : self._at]

    def string(self) -> str:
        """A string, with or without a terminating zero."""
        return bytes(self.blob()).rstrip(b"\0").decode()

    def time_ns(self) -> int:
        """A builtin_interfaces/Time."""
        return self.uint32() * 1_000_000_000 + self.uint32()

    def header(self) -> tuple[int, str]:
        """A std_msgs/Header: its stamp and frame id."""
        return self.time_ns(), self.string()

    def number(self, code: str) -> float:
        """A number by its code in `struct`."""
        size = struct.calcsize("<" + code)
        self._at += -(self._at - self._start) % min(size, self._alignment)
        value: float = struct.unpack_from(self._order + code, self._payload, self._at)[0]
        self._at += size
        return value


class CdrReader(SequentialReader):
    """ROS 2: CDR of XCDR1, behind a head of 4 bytes whose second tells the byte order."""

    _start = 4
    _alignment = 8

    def __init__(self, payload: memoryview) -> None:
        super().__init__(payload)
        self._order = "<" if payload[1] & 1 else ">"


class Ros1Reader(SequentialReader):
    """ROS 1: little-endian, nothing aligned."""

    _start = 0
    _alignment = 1

    def header(self) -> tuple[int, str]:
        """A std_msgs/Header, which begins with a sequence number here."""
        self.uint32()
        return super().header()


class FlatbufferTable:
    """A table of a FlatBuffers message, the root by default.

    Fields go by their id; one that is absent is 0 or empty.
    """

    def __init__(self, payload: memoryview, at: int | None = None) -> None:
        self._payload = payload
        self._table = self._unpack("<I", 0) if at is None else at
        self._vtable = self._table - self._unpack("<i", self._table)
        if self._vtable < 0:
            raise ValueError("the table lies outside the message")
        self._vtable_size = self._unpack("<H", self._vtable)

    def uint32(self, field: int) -> int:
        """An unsigned number."""
        at = self._position(field)
        return self._unpack("<I", at) if at else 0

    def float64(self, field: int, default: float = 0.0) -> float:
        """A double, or the schema's `default` of it."""
        at = self._position(field)
        value: float = struct.unpack_from("<d", self._payload, at)[0] if at else default
        return value

    def float64s(self, field: int) -> tuple[float, ...]:
        """A vector of doubles."""
        at = self._position(field)
        start = at + self._unpack("<I", at) if at else 0
        count = self._unpack("<I", start) if at else 0
        return struct.unpack_from(f"<{count}d", self._payload, start + 4) if count else ()

    def table(self, field: int) -> FlatbufferTable | None:
        """A table within this one; None when it is absent."""
        at = self._position(field)
        return FlatbufferTable(self._payload, at + self._unpack("<I", at)) if at else None

    def time_ns(self, field: int) -> int:
        """A struct of seconds and nanoseconds."""
        at = self._position(field)
        return self._unpack("<I", at) * 1_000_000_000 + self._unpack("<I", at + 4) if at else 0

    def blob(self, field: int) -> memoryview:
        """A vector of bytes."""
        at = self._position(field)
        if not at:
            return self._payload[:0]
        start = at + self._unpack("<I", at) + 4
        end = start + self._unpack("<I", start - 4)
        if end > len(self._payload):
            raise ValueError("a field overruns the message")
        return self._payload[start:end]

    def string(self, field: int) -> str:
        """A string."""
        return bytes(self.blob(field)).decode()

    def _position(self, field: int) -> int:
        """Where a field lies; 0 when it is absent."""
        slot = 4 + 2 * field
        offset = self._unpack("<H", self._vtable + slot) if slot < self._vtable_size else 0
        return self._table + offset if offset else 0

    def _unpack(self, code: str, at: int) -> int:
        value: int = struct.unpack_from(code, self._payload, at)[0]
        return value
