"""Messages of any schema as fields by name: JSON, protobuf, and ROS 1 and 2 by their definitions."""

from __future__ import annotations

import json
import re
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

from google.protobuf import descriptor_pool, message_factory
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.message import DecodeError, Message

from inspect_pipeline.messages.cdr import CdrReader, Ros1Reader
from inspect_pipeline.messages.names import type_name

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from inspect_pipeline.messages.cdr import SequentialReader

    Fields = Mapping[str, Any]
    Decoder = Callable[[memoryview], Fields]
    Definitions = Mapping[str, Sequence["_Field"]]

_CODES = {
    "bool": "?",
    "int8": "b",
    "uint8": "B",
    "char": "B",
    "byte": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
_FIELD = re.compile(r"([\w/]+)(?:<=\d+)?(\[(?:<=)?\d*\])?\s+(\w+)\b(?!\s*=)")
_SECTION = re.compile(r"^=+\s*\nMSG:\s*(\S+)\s*$", re.MULTILINE)
_TIMES = ("time", "duration", "builtin_interfaces/Time", "builtin_interfaces/Duration")


class _Field(NamedTuple):
    """A field of a ROS message; length is None for one value, -1 for a sequence, else of an array."""

    name: str
    type_name: str
    length: int | None


def decoder_for(schema_name: str, schema_data: bytes, message_encoding: str) -> Decoder | None:
    """Return what decodes the messages of a channel; None for an encoding or schema that is not read.

    The decoder returns the fields by name, and raises one of `errors.MALFORMED`.
    """
    if message_encoding == "json":
        return _decode_json
    if message_encoding in {"cdr", "ros1"} and not schema_data.lstrip().startswith(b"module "):  # IDL
        reader = CdrReader if message_encoding == "cdr" else Ros1Reader
        name, definitions = type_name(schema_name), _read_definitions(schema_name, schema_data)
        return lambda payload: _read_message(reader(payload), name, definitions)
    if message_encoding == "protobuf":
        try:
            return partial(_decode_protobuf, _message_class(schema_name, schema_data))
        except (DecodeError, KeyError, TypeError, ValueError):  # not a usable FileDescriptorSet
            return None
    return None


def value_at(fields: Any, path: Sequence[str | int]) -> Any:
    """Return the value at a path of field names and indexes; raises one of `errors.MALFORMED`."""
    for step in path:
        is_message = isinstance(fields, Message)
        fields = getattr(fields, str(step)) if is_message else fields[step]
    return fields


def _decode_json(payload: memoryview) -> Fields:
    fields: Fields = json.loads(bytes(payload))
    return fields


def _message_class(schema_name: str, schema_data: bytes) -> type[Message]:
    """Build the class of a message from the FileDescriptorSet of its schema."""
    pool = descriptor_pool.DescriptorPool()
    for file in FileDescriptorSet.FromString(schema_data).file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(schema_name))


def _decode_protobuf(message_class: type[Message], payload: memoryview) -> Fields:
    message = message_class.FromString(bytes(payload))
    return {name: getattr(message, name) for name in message.DESCRIPTOR.fields_by_name}


def _read_definitions(schema_name: str, schema_data: bytes) -> Definitions:
    """Return the fields of a message and of the messages in it, by type name."""
    first, *others = _SECTION.split(schema_data.decode(errors="replace"))
    names = [schema_name, *others[::2]]
    package = type_name(schema_name).rpartition("/")[0]
    return {
        type_name(name): _read_fields(text, type_name(name).rpartition("/")[0] or package)
        for name, text in zip(names, [first, *others[1::2]], strict=True)
    }


def _read_fields(text: str, package: str) -> list[_Field]:
    fields = []
    for line in text.splitlines():
        match = _FIELD.match(line.split("#")[0].strip())
        if match:
            kind, brackets, name = match.groups()
            length = None if brackets is None else int(brackets[1:-1]) if brackets[1:-1].isdigit() else -1
            fields.append(_Field(name, _full_name(kind, package), length))
    return fields


def _full_name(kind: str, package: str) -> str:
    if kind in _CODES or kind in {"string", "wstring", *_TIMES}:
        return kind
    if kind == "Header":
        return "std_msgs/Header"
    return type_name(kind) if "/" in kind else f"{package}/{kind}"


def _read_message(reader: SequentialReader, name: str, definitions: Definitions) -> Fields:
    """Read the fields of a message, up to the first of a type that the schema does not define."""
    fields: dict[str, Any] = {}
    for field in definitions[name]:
        if not _is_known(field.type_name, definitions):
            break
        fields[field.name] = _read_field(reader, field, definitions)
    return fields


def _is_known(name: str, definitions: Definitions) -> bool:
    return name in _CODES or name == "string" or name in _TIMES or name in definitions


def _read_field(reader: SequentialReader, field: _Field, definitions: Definitions) -> Any:
    if field.length is None:
        return _read_value(reader, field.type_name, definitions)
    length = reader.uint32() if field.length < 0 else field.length
    if field.type_name in _CODES:
        return reader.numbers(_CODES[field.type_name], length)
    if length > reader.n_bytes:  # each element takes at least one
        raise ValueError("a field reaches beyond the end of the message")
    return [_read_value(reader, field.type_name, definitions) for _ in range(length)]


def _read_value(reader: SequentialReader, name: str, definitions: Definitions) -> Any:
    if name in _CODES:
        return reader.number(_CODES[name])
    if name == "string":
        return reader.string()
    if name in definitions:
        return _read_message(reader, name, definitions)
    return dict(zip(("sec", "nanosec"), reader.numbers("i", 2), strict=True))
