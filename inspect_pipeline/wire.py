"""Fields read from messages of ROS and FlatBuffers without their packages: what image messages need.

Readers raise ValueError or struct.error when a message is shorter than it says.
"""

from __future__ import annotations

import struct
from typing import ClassVar


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
        return self._number("B", 1)

    def uint32(self) -> int:
        """Four bytes."""
        return self._number("I", 4)

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

    def _number(self, code: str, size: int) -> int:
        self._at += -(self._at - self._start) % min(size, self._alignment)
        value: int = struct.unpack_from(self._order + code, self._payload, self._at)[0]
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
    """The root table of a FlatBuffers message. Fields go by their id; one that is absent is 0 or empty."""

    def __init__(self, payload: memoryview) -> None:
        self._payload = payload
        self._table = self._unpack("<I", 0)
        self._vtable = self._table - self._unpack("<i", self._table)
        if self._vtable < 0:
            raise ValueError("the table lies outside the message")
        self._vtable_size = self._unpack("<H", self._vtable)

    def uint32(self, field: int) -> int:
        """An unsigned number."""
        at = self._position(field)
        return self._unpack("<I", at) if at else 0

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
