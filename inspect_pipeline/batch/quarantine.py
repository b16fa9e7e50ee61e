"""Recordings that are set aside until they change: a note per path in the store; the files stay in place.

quarantine/<first 16 hex of the sha256 of the path>.json
"""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from inspect_pipeline.atomic import store_errors, write_whole
from inspect_pipeline.batch.inbox import Candidate
from inspect_pipeline.resources import app_version
from inspect_pipeline.store.records import parse_json

if TYPE_CHECKING:
    from collections.abc import Mapping

    from inspect_pipeline.store.store import Store


@dataclass(frozen=True, slots=True)
class QuarantineNote:
    """Why a recording was given up, by which version and config, and the state of the file at that time.

    reason: unreadable, error, killed or timeout; at: ISO 8601 in UTC; mtime_ns: ns since 1970.
    """

    path: str
    size_bytes: int
    mtime_ns: int
    reason: str
    detail: str
    attempts: int
    app_version: str
    config_sha256: str
    at: str

    @property
    def note_id(self) -> str:
        """The name of the note, which depends on the path alone."""
        return _note_id(self.path)

    def is_about(self, candidate: Candidate | None) -> bool:
        """Whether the file has not changed since."""
        return candidate is not None and (self.size_bytes, self.mtime_ns) == (
            candidate.size_bytes,
            candidate.mtime_ns,
        )

    def to_json(self) -> dict[str, Any]:
        """Return the content of the note's file, with its id."""
        return {"id": self.note_id, **asdict(self)}

    @classmethod
    def from_json(cls, value: Mapping[str, Any]) -> QuarantineNote:
        """Read what `to_json` wrote; raises KeyError or TypeError for anything else."""
        return cls(**{name: value[name] for name in cls.__dataclass_fields__})


class Quarantine:
    """The notes of a store. A note applies to the file, program version and config it was written for.

    Every method raises StoreError when the store cannot be read or written.
    """

    def __init__(self, store: Store) -> None:
        self._folder = store.root / "quarantine"

    def notes(self) -> list[QuarantineNote]:
        """Return all notes, oldest first, skipping files that are not notes."""
        with store_errors(self._folder):
            paths = sorted(self._folder.glob("*.json"))
            found = [note for path in paths if (note := _load(path))]
        return sorted(found, key=lambda note: note.at)

    def holds(self, candidate: Candidate, config_sha256: str) -> bool:
        """Whether a recording is in quarantine for this version and config."""
        with store_errors(self._folder):
            note = _load(self._path(str(candidate.path)))
        return (
            note is not None
            and note.is_about(candidate)
            and (note.app_version, note.config_sha256) == (app_version(), config_sha256)
        )

    def add(self, note: QuarantineNote) -> None:
        """Write a note, replacing an older one of the same path."""
        with store_errors(self._folder):
            self._folder.mkdir(parents=True, exist_ok=True)
            write_whole(self._path(note.path), json.dumps(note.to_json(), indent=1) + "\n")

    def remove(self, path: str) -> None:
        """Remove the note of a path, if there is one."""
        with store_errors(self._folder):
            self._path(path).unlink(missing_ok=True)

    def remove_stale(self) -> list[QuarantineNote]:
        """Remove the notes of recordings that are gone or were replaced, and return them."""
        stale = [note for note in self.notes() if not note.is_about(Candidate.at(Path(note.path)))]
        for note in stale:
            self.remove(note.path)
        return stale

    def _path(self, recording: str) -> Path:
        return self._folder / f"{_note_id(recording)}.json"


def _note_id(recording: str) -> str:
    return hashlib.sha256(os.fsencode(recording)).hexdigest()[:16]


def _load(path: Path) -> QuarantineNote | None:
    try:
        return QuarantineNote.from_json(parse_json(path.read_bytes()))
    except (FileNotFoundError, NotADirectoryError, KeyError, TypeError, ValueError):
        return None
