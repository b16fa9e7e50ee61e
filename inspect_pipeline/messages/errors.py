"""Exceptions that parsing a malformed message can raise."""

from __future__ import annotations

import struct

from google.protobuf.message import DecodeError

# Callers catch this tuple: parsers index, convert and decode whatever a message contains, in CDR, JSON,
# FlatBuffers and protobuf alike, so a malformed one fails in many ways.
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
