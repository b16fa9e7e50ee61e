"""FlatBuffers messages, read by field id without generated code."""

from __future__ import annotations

import struct


class FlatbufferTable:
    """A table of a FlatBuffers message, by default its root.

    A field that is absent reads as 0 or empty. Methods raise ValueError or struct.error when the message is
    malformed.
    """

    def __init__(self, payload: memoryview, at: int | None = None) -> None:
        self._payload = payload
        self._table = self._unpack("<I", 0) if at is None else at
        self._vtable = self._table - self._unpack("<i", self._table)
        if self._vtable < 0:
            raise ValueError("the table lies outside the message")
        self._vtable_size = self._unpack("<H", self._vtable)

    def uint32(self, field: int) -> int:
        """Read an unsigned number."""
        at = self._position(field)
        return self._unpack("<I", at) if at else 0

    def float64(self, field: int, default: float = 0.0) -> float:
        """Read a double; `default` is the schema's, for a field that is absent."""
        at = self._position(field)
        value: float = struct.unpack_from("<d", self._payload, at)[0] if at else default
        return value

    def float64s(self, field: int) -> tuple[float, ...]:
        """Read a vector of doubles."""
        at = self._position(field)
        start = at + self._unpack("<I", at) if at else 0
        count = self._unpack("<I", start) if at else 0
        return struct.unpack_from(f"<{count}d", self._payload, start + 4) if count else ()

    def table(self, field: int) -> FlatbufferTable | None:
        """Return a nested table; None when it is absent."""
        at = self._position(field)
        return FlatbufferTable(self._payload, at + self._unpack("<I", at)) if at else None

    def time_ns(self, field: int) -> int:
        """Read a struct of seconds and nanoseconds."""
        at = self._position(field)
        return self._unpack("<I", at) * 1_000_000_000 + self._unpack("<I", at + 4) if at else 0

    def blob(self, field: int) -> memoryview:
        """Read a vector of bytes, without copying it."""
        at = self._position(field)
        if not at:
            return self._payload[:0]
        start = at + self._unpack("<I", at) + 4
        end = start + self._unpack("<I", start - 4)
        if end > len(self._payload):
            raise ValueError("a field reaches beyond the end of the message")
        return self._payload[start:end]

    def string(self, field: int) -> str:
        """Read a string."""
        return bytes(self.blob(field)).decode()

    def _position(self, field: int) -> int:
        """Return the offset of a field; 0 when it is absent."""
        slot = 4 + 2 * field
        offset = self._unpack("<H", self._vtable + slot) if slot < self._vtable_size else 0
        return self._table + offset if offset else 0

    def _unpack(self, code: str, at: int) -> int:
        value: int = struct.unpack_from(code, self._payload, at)[0]
        return value
