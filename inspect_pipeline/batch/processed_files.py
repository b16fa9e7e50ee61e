"""The cache of processed files: the flight of each file of the inbox, so that unchanged files are not read.

stat_cache.jsonl, one line per file. It may be deleted: files are then hashed again, but not processed again.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from inspect_pipeline.atomic import store_errors, write_whole
from inspect_pipeline.store.records import parse_json

if TYPE_CHECKING:
    from inspect_pipeline.batch.inbox import Candidate
    from inspect_pipeline.store.store import Store

ANNOTATED_COPY = "annotated copy"  # in place of a flight_id
_MAX_STALE_LINES = 1000


class StatCache:
    """The cache of a store, loaded; raises StoreError when it cannot be read or written."""

    def __init__(self, store: Store) -> None:
        self._path = store.root / "stat_cache.jsonl"
        self._known: dict[str, tuple[int, int, str]] = {}
        with store_errors(self._path):
            lines = self._path.read_bytes().splitlines() if self._path.exists() else []
        for line in lines:
            self._read(line)
        self._n_stale = len(lines) - len(self._known)

    def flight_id(self, candidate: Candidate) -> str | None:
        """Return the flight in an unchanged file, ANNOTATED_COPY for an annotated copy, else None."""
        size_bytes, mtime_ns, flight_id = self._known.get(str(candidate.path), (-1, -1, ""))
        return flight_id if (size_bytes, mtime_ns) == (candidate.size_bytes, candidate.mtime_ns) else None

    def add(self, candidate: Candidate, flight_id: str) -> None:
        """Remember the flight of a file."""
        entry = (candidate.size_bytes, candidate.mtime_ns, flight_id)
        self._known[str(candidate.path)] = entry
        with store_errors(self._path), self._path.open("a", encoding="utf-8") as file:
            file.write(_to_line(str(candidate.path), entry))

    def compact(self) -> None:
        """Rewrite the file without outdated lines, once there are many."""
        if self._n_stale <= _MAX_STALE_LINES:
            return
        self._known = {path: entry for path, entry in self._known.items() if Path(path).exists()}
        with store_errors(self._path):
            write_whole(self._path, "".join(_to_line(*item) for item in self._known.items()))

    def _read(self, line: bytes) -> None:
        try:
            path, size_bytes, mtime_ns, flight_id = parse_json(line)
        except (TypeError, ValueError):  # cut by a kill or a full disk
            return
        self._known[path] = (size_bytes, mtime_ns, flight_id)


def _to_line(path: str, entry: tuple[int, int, str]) -> str:
    return json.dumps([path, *entry]) + "\n"
