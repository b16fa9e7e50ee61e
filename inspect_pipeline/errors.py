"""The errors that users can meet. A message is one line: the file, what is wrong with it, what to do.

Messages name facts and arguments of the Python API, never an option of a command: see `report_error`.

InspectError
├── FileError                    about one file: path, problem, remedy
│   ├── RecordingError           a recording cannot be read
│   │   ├── DamagedRecordingError    a part of it is lost, and all is required
│   │   ├── NoImagesError            it is intact and has no images
│   │   └── AnnotationChannelError   annotations cannot be added to it
│   ├── StoreError               a store cannot be read
│   │   ├── StoreWriteError      a store cannot be written
│   │   ├── StoreBusyError       another process holds it: exit 11
│   │   └── StoreVersionError    a newer version wrote it: exit 12
│   ├── InboxError               a folder or file of the inbox cannot be read
│   ├── OutputError              a file cannot be written
│   ├── RulesError               a rules file cannot be used
│   ├── SpansError               a spans file cannot be used
│   └── TerrainError             a terrain model cannot be used
├── EmptyResultError             a result with frames would be replaced by one without
├── MissingExtraError            an optional package is needed and not installed
├── HookError                    the command to run after a batch failed
├── QueryError                   an SQL statement is refused or fails
│   ├── QueryTimeoutError        it takes too long
│   ├── QueryValuesError         a named query lacks values
│   ├── UnknownIdError           no flight, anomaly … has such an id
│   └── AmbiguousIdError         an abbreviated id stands for several
└── DetectorError                weights, images or training data cannot be used
    └── ExecutorError            the workers of a batch cannot be reached
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path


MAX_MESSAGE = 1000  # characters


class InspectError(Exception):
    """Base of all errors that users can meet; `str(error)` is one line."""

    exit_code: ClassVar[int] = 1

    def __init__(self, message: str) -> None:
        super().__init__(shorten(printable(message)))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle by attributes: `__init__` of subclasses takes other arguments than the message."""
        return _unpickle, (type(self), str(self), self.__dict__)


def printable(text: str) -> str:
    """Return the text with a ? for each control character: names in damaged files can hold anything."""
    return text if text.isprintable() else "".join(c if c.isprintable() else "?" for c in text)


def count_of(number: int, noun: str, plural: str | None = None) -> str:
    """Return a number with its noun: `1 flight`, `1,200 flights`."""
    return f"{number:,} {noun if number == 1 else plural or noun + 's'}"


def shorten(text: str) -> str:
    """Cut out the middle of what names in damaged files or a statement make too long to read."""
    n_end = MAX_MESSAGE // 3  # with what to do
    return text if len(text) <= MAX_MESSAGE else f"{text[: MAX_MESSAGE - n_end - 3]}...{text[-n_end:]}"


def _unpickle(kind: type[InspectError], message: str, attributes: dict[str, Any]) -> InspectError:
    error = kind.__new__(kind)
    error.args = (message,)
    error.__dict__.update(attributes)
    return error


class FileError(InspectError):
    """Base of the errors about one file or folder: `path: problem; remedy`."""

    def __init__(self, path: Path, problem: str, remedy: str) -> None:
        super().__init__(f"{path}: {problem}; {remedy}")
        self.path, self.problem, self.remedy = path, problem, remedy


class RecordingError(FileError):
    """Raised when a recording cannot be read."""


class AnnotationChannelError(RecordingError):
    """Raised when the channels of annotations cannot be added to a recording."""

    def __init__(self, path: Path, problem: str) -> None:
        super().__init__(path, problem, "process it without writing annotations")


class DamagedRecordingError(RecordingError):
    """Raised when a part of a recording is lost and the caller requires all of it."""

    def __init__(self, path: Path, problem: str) -> None:
        super().__init__(path, problem, "copy it again, or process the part that can be read")


class NoImagesError(RecordingError):
    """Raised when an intact recording has no images, as one of telemetry only."""


class StoreError(FileError):
    """Raised when a store cannot be read."""


class StoreWriteError(StoreError):
    """Raised when a store cannot be written."""


class StoreBusyError(StoreError):
    """Raised when another process holds the store."""

    exit_code = 11


class StoreVersionError(StoreError):
    """Raised when a newer version of this program wrote the store."""

    exit_code = 12


class InboxError(FileError):
    """Raised when a folder or file of the inbox is missing or cannot be read."""


class OutputError(FileError):
    """Raised when a file cannot be written."""


class RulesError(FileError):
    """Raised when a rules file cannot be used."""


class SpansError(FileError):
    """Raised when a spans file cannot be used."""


class TerrainError(FileError):
    """Raised when a terrain model cannot be used."""


class EmptyResultError(InspectError):
    """Raised when a result with frames would be replaced by one without."""

    def __init__(self, path: Path, flight_id: str, n_frames: int) -> None:
        super().__init__(
            f"{path}: no frame is selected, and flight {flight_id[:16]} has {n_frames:,} in the store, which"
            " stay as they are; select other frames"
        )
        self.path, self.flight_id, self.n_frames = path, flight_id, n_frames


class MissingExtraError(InspectError):
    """Raised when an optional package is needed and not installed."""

    def __init__(self, what: str, extra: str) -> None:
        super().__init__(f"{what} needs the extra {extra}: pip install 'lsnet-pipe[{extra}]'")
        self.extra = extra


class HookError(InspectError):
    """Raised when the command to run after a batch fails."""

    def __init__(self, command: str, problem: str) -> None:
        super().__init__(f"{command}: the command failed after the end of the batch ({problem}); check it")
        self.command, self.problem = command, problem


class QueryError(InspectError):
    """Raised when an SQL statement is refused or fails."""


class QueryTimeoutError(QueryError):
    """Raised when an SQL statement takes too long."""

    def __init__(self, timeout_s: float) -> None:
        super().__init__(f"the query was stopped after {timeout_s:g} s; narrow it or allow more time")
        self.timeout_s = timeout_s


class QueryValuesError(QueryError):
    """Raised when a named query is given other values than it needs."""

    def __init__(self, name: str, needed: Sequence[str]) -> None:
        if needed:
            message = f"the query {name} needs a value of {' and of '.join(needed)}, and no other"
        else:
            message = f"the query {name} takes no values; leave them out"
        super().__init__(message)
        self.name, self.needed = name, tuple(needed)


class UnknownIdError(QueryError):
    """Raised when no thing of a kind has an id that begins as given."""

    def __init__(self, kind: str, beginning: str, command: str) -> None:
        super().__init__(f"no {kind} begins with {beginning!r}; lsnet-pipe {command} shows the ids")
        self.kind, self.beginning = kind, beginning


class AmbiguousIdError(QueryError):
    """Raised when an abbreviated id stands for several things."""

    def __init__(self, kind: str, beginning: str, count: int) -> None:
        super().__init__(f"{count} ids begin with {beginning!r}; give more characters of the {kind} id")
        self.kind, self.beginning, self.count = kind, beginning, count


class DetectorError(InspectError):
    """Raised when weights, images or training data cannot be used."""


class ExecutorError(DetectorError):
    """Raised when the workers of a batch cannot be reached."""
