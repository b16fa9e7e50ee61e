"""The folder of a flight: its record, and whether its files are those that were written."""

from __future__ import annotations

import hashlib
import json
import os
import stat
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from inspect_pipeline.atomic import explain_os_error
from inspect_pipeline.errors import StoreVersionError
from inspect_pipeline.store.records import RESULT_VERSION, FlightRecord, parse_json

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

RESULT = "result.json"


class DamagedFlight(NamedTuple):
    """A folder among the flights that cannot be used, and why."""

    folder: Path
    problem: str


@dataclass(frozen=True, slots=True)
class StoredFlight:
    """A flight of the store: its folder, its record, and the sha256 of the record's file."""

    folder: Path
    record: FlightRecord
    result_sha256: str

    @property
    def row_files(self) -> list[str]:
        """The names of its parquet files."""
        return [name for name in self.record.files if name.endswith(".parquet")]

    def check_sizes(self) -> str | None:
        """Return a phrase about a file that is missing or has another size than it was written with."""
        for name, size_bytes in self.record.files.items():
            found = _size_bytes(f"{self.folder}/{name}")
            if found != size_bytes:
                return f"{name} is missing" if found is None else f"{name} has another size"
        return None

    def check_content(self, names: Iterable[str]) -> str | None:
        """Return a phrase about a file whose checksum differs; raises OSError.

        Files of older versions have no checksum and pass.
        """
        for name in names:
            if name in self.record.sha256 and file_sha256(self.folder / name) != self.record.sha256[name]:
                return f"the checksum of {name} differs"
        return None


def load_flight(folder: Path) -> StoredFlight | None:
    """Return the flight of a folder, None if its record is missing or cannot be read; raises StoreError."""
    try:
        content = (folder / RESULT).read_bytes()
        value = parse_json(content)
        if value["result_version"] > RESULT_VERSION:
            raise StoreVersionError(folder / RESULT, "written by a newer version", "upgrade lsnet-pipe")
        record = FlightRecord.from_json(value)
    except (FileNotFoundError, NotADirectoryError, AttributeError, KeyError, TypeError, ValueError):
        return None
    except OSError as error:
        raise explain_os_error(folder, error) from error
    return StoredFlight(folder, record, hashlib.sha256(content).hexdigest())


def find_problem(folder: Path, stored: StoredFlight | None) -> str | None:
    """Return a phrase about what is wrong with a folder among the flights."""
    if stored is None:
        return "its result.json is missing or cannot be read; process its recording again"
    name = stored.record.flight_id[:16]
    if name != folder.name:
        return f"a copy of flight {name} under another name; remove it, or rename it if that one is missing"
    problem = stored.check_sizes()
    return f"{problem}; process its recording again" if problem else None


def result_text(record: FlightRecord) -> str:
    """Return the content of result.json."""
    return json.dumps(record.to_json(), indent=1) + "\n"


def file_sha256(path: Path) -> str:
    """Return the sha256 of a file in hex; raises OSError."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _size_bytes(path: str) -> int | None:
    """Return the size of a file, None for anything else; a str, as scans of large stores wait for this."""
    try:
        found = os.stat(path)  # noqa: PTH116
    except (FileNotFoundError, NotADirectoryError):
        return None
    return found.st_size if stat.S_ISREG(found.st_mode) else None
