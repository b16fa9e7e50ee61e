"""Every error a user can meet, one line each: the message names the file and says what to do.

InspectError
├── FileError                about one file: path, problem, remedy
│   ├── RecordingError       a recording that cannot be read or annotated
│   │   └── NoImagesError        an intact recording without images
│   ├── StoreError           a store that cannot be read or written
│   │   ├── StoreBusyError       exit 11
│   │   └── StoreVersionError    exit 12
│   ├── InboxError           a folder or file of the inbox that is not there
│   ├── OutputError          a file that cannot be written where it was asked for
│   ├── RulesError           thresholds that cannot be used
│   ├── SpansError           spans that cannot be used
│   └── TerrainError         a terrain model that cannot be used
├── HookError                a command of --on-finish that fails
├── QueryError               an SQL statement that is refused or fails
└── DetectorError            weights, images or training data that cannot be used
"""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

if TYPE_CHECKING:
    from pathlib import Path


class InspectError(Exception):
    """Base of all errors that are told to the user in one line."""

    exit_code: ClassVar[int] = 1


class FileError(InspectError):
    """Base of the errors about one file or folder: `path: problem; remedy`."""

    def __init__(self, path: Path, problem: str, remedy: str) -> None:
        message = f"{path}: {problem}; {remedy}"
        # Names, and texts inside a damaged file, may hold anything; a message stays one line.
        super().__init__("".join(c if c.isprintable() else "?" for c in message))
        self.path, self.problem, self.remedy = path, problem, remedy

    def __reduce__(self) -> tuple[type[FileError], tuple[Path, str, str]]:
        """Workers send it to their parent, and what pickle makes of an exception's text fits no __init__."""
        return type(self), (self.path, self.problem, self.remedy)


class RecordingError(FileError):
    """Raised when a recording cannot be read or annotated."""


class NoImagesError(RecordingError):
    """Raised when an intact recording has no images, as one of telemetry only."""


class StoreError(FileError):
    """Raised when a store cannot be read or written."""


class StoreBusyError(StoreError):
    """Raised when another process holds the store."""

    exit_code = 11


class StoreVersionError(StoreError):
    """Raised when a store was written by a newer version of this program."""

    exit_code = 12


class InboxError(FileError):
    """Raised when there is no such folder or file to look into, or it cannot be read."""


class OutputError(FileError):
    """Raised when a file cannot be written."""


class RulesError(FileError):
    """Raised when a file of rules cannot be used."""


class SpansError(FileError):
    """Raised when a file of spans cannot be used."""


class TerrainError(FileError):
    """Raised when a terrain model cannot be used."""


class HookError(InspectError):
    """Raised when the command of --on-finish fails."""

    def __init__(self, command: str, problem: str) -> None:
        super().__init__(f"{command}: the command of --on-finish failed ({problem}); the batch had ended")
        self.command, self.problem = command, problem


class QueryError(InspectError):
    """Raised when an SQL statement is refused or fails."""


class DetectorError(InspectError):
    """Raised when weights, images or training data cannot be used."""
