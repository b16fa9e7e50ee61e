"""The store: one folder per flight, written whole or not at all, with locks and a log beside.

flights/<16 hex of flight_id>/   annotated.mcap, *.parquet and, last, result.json
spans.geojson, rules.toml        what people told, and reviews.jsonl and tags.jsonl: never derived
index.duckdb                     derived from all of these, see index.py
manifest.jsonl                   a log, never read back
staging/                         flights being written
lock, publish.lock               held by `batch` and by a publish
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import secrets
import shutil
import stat
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from inspect_pipeline.atomic import (
    OUT_OF_SPACE,
    acquire_lock,
    explain_os_error,
    fsync_path,
    fsync_tree,
    move_folder_into_place,
    store_errors,
    undo_move_aside,
    write_whole,
)
from inspect_pipeline.errors import StoreBusyError, StoreVersionError, StoreWriteError
from inspect_pipeline.store.records import ANNOTATED, RESULT_VERSION, FlightRecord

if TYPE_CHECKING:
    from collections.abc import Iterator

_RESULT = "result.json"


def store_path(option: Path | None) -> Path:
    """The store's folder: `option`, else LSNET_PIPE_STORE, else ./inspections."""
    return option or Path(os.environ.get("LSNET_PIPE_STORE") or "inspections")


@dataclass(frozen=True, slots=True)
class StoredFlight:
    """A flight of the store: its folder, its record, and the sha256 of the record's file."""

    folder: Path
    record: FlightRecord
    result_sha256: str

    def is_whole(self) -> bool:
        """Whether every file of the flight is there with the size it was written with."""
        return all(
            _size_bytes(f"{self.folder}/{name}") == size_bytes
            for name, size_bytes in self.record.files.items()
        )


@dataclass(frozen=True, slots=True)
class Staging:
    """A flight being written: fill the folder `path`, then commit."""

    path: Path
    _store: Store

    def commit(self, record: FlightRecord) -> Path:
        """Make the flight visible, in place of an older result of it, and return its folder.

        Everything is on the disk before result.json is written, and result.json before the folder
        gets its name. Raises StoreError.
        """
        final = self._store.flight_dir(record.flight_id)
        with store_errors(self._store.root):
            files = {p.relative_to(self.path).as_posix(): p for p in self.path.rglob("*") if p.is_file()}
            fsync_tree(self.path)
            sized = record.with_files({name: files[name].stat().st_size for name in sorted(files)})
            (self.path / _RESULT).write_text(_to_text(sized), encoding="utf-8")
            fsync_path(self.path / _RESULT)
            fsync_path(self.path)
            with self._store.changing_flights():
                move_folder_into_place(self.path, final, _aside(self.path))
            fsync_path(final.parent)
        self._store.append_manifest(
            "flight", flight_id=record.flight_id, source=record.source_uri, run_id=record.run.run_id
        )
        return final


class Store:
    """The folder `root`; nothing is made on disk before the first write.

    Raises StoreWriteError for a name that DuckDB would take for a pattern or for options.
    """

    def __init__(self, root: Path) -> None:
        self.root = root.absolute()
        if re.search(r"[?*\\\n]", str(self.root)):
            raise StoreWriteError(
                self.root, "a store cannot be in a folder of this name", "use another folder"
            )
        self.index_path = self.root / "index.duckdb"
        self._flights = self.root / "flights"
        self._staging = self.root / "staging"

    def flight_dir(self, flight_id: str) -> Path:
        """The folder of a flight, there or not; raises ValueError unless given a sha256 in hex."""
        if not re.fullmatch(r"[0-9a-f]{64}", flight_id):
            raise ValueError(f"not a flight_id: {flight_id!r}")
        return self._flights / flight_id[:16]

    def load_flight(self, flight_id: str) -> FlightRecord | None:
        """The record of a flight, or None when the store has no whole result of it."""
        stored = self._load(self.flight_dir(flight_id))
        return stored.record if stored and stored.is_whole() else None

    def scan(self) -> tuple[list[StoredFlight], list[Path]]:
        """All flights by time, and the folders without a readable result.json; raises StoreError."""
        with store_errors(self.root):
            folders = sorted(self._flights.iterdir()) if self._flights.exists() else []
        found = {folder: self._load(folder) for folder in folders}
        flights = [stored for stored in found.values() if stored]
        flights.sort(key=lambda stored: (stored.record.totals.start_ns or 0, stored.record.flight_id))
        return flights, [folder for folder, stored in found.items() if stored is None]

    @contextmanager
    def write_flight(self, flight_id: str) -> Iterator[Staging]:
        """A folder to write a flight in; it is gone after the block, and so is all in it, unless committed.

        Leftovers of killed processes are removed first. Raises StoreError.
        """
        with store_errors(self.root):
            self._flights.mkdir(parents=True, exist_ok=True)
            self._staging.mkdir(exist_ok=True)
        path = self._staging / f"{self.flight_dir(flight_id).name}-{secrets.token_hex(4)}"
        with self._own(path):
            try:
                with store_errors(self.root):
                    path.mkdir()
                yield Staging(path, self)
            except OSError as error:
                if error.errno in OUT_OF_SPACE:
                    raise explain_os_error(self.root, error) from error
                raise

    def remove_annotated_copy(self, stored: StoredFlight) -> None:
        """Remove the annotated copy of a flight, which its record says first; raises StoreError.

        A flight that was replaced meanwhile keeps its own.
        """
        with store_errors(self.root), self.changing_flights():
            if self._load(stored.folder) != stored:
                return
            if stored.record.annotations == ANNOTATED:
                record = stored.record.without_annotations()
                write_whole(stored.folder / _RESULT, _to_text(record))
            (stored.folder / ANNOTATED).unlink(missing_ok=True)
        self.append_manifest("annotated copy removed", flight_id=stored.record.flight_id)

    def remove_flight(self, flight_id: str) -> None:
        """Remove a flight, at once for all readers of the store; raises StoreError."""
        folder = self.flight_dir(flight_id)
        path = self._staging / f"{folder.name}-{secrets.token_hex(4)}"
        with store_errors(self.root):
            self._staging.mkdir(exist_ok=True)
            with self._own(path), self.changing_flights():
                folder.rename(path)
                fsync_path(folder.parent)
        self.append_manifest("flight removed", flight_id=flight_id)

    @contextmanager
    def changing_flights(self) -> Iterator[None]:
        """Keep every other process from putting a flight in place or changing one; raises OSError."""
        self._staging.mkdir(parents=True, exist_ok=True)
        with acquire_lock(self._staging / "mutex", wait=True):
            yield

    @contextmanager
    def _own(self, path: Path) -> Iterator[None]:
        """Hold the lock beside the staging folder `path`, which tells others that its process lives."""
        with store_errors(self.root), self.changing_flights():
            self._discard_dead()
            lock = acquire_lock(_lock_of(path), wait=False)
        with lock:
            try:
                yield
            finally:
                self._discard(path)

    def remove_leftovers(self) -> None:
        """Remove what killed processes left behind; live ones keep theirs. Raises StoreError."""
        if self._staging.exists():
            with store_errors(self.root), self.changing_flights():
                self._discard_dead()

    def _discard_dead(self) -> None:
        """Discard the staging folders whose lock is free; the caller holds the mutex."""
        for path in self._staging.glob("*.lock"):
            with suppress(BlockingIOError), acquire_lock(path, wait=False):
                self._discard(path.with_suffix(""))

    def _discard(self, staging: Path) -> None:
        """Remove a staging folder and, last, its lock, which the caller holds."""
        undo_move_aside(self._flights / staging.name.split("-")[0], _aside(staging))
        shutil.rmtree(staging, ignore_errors=True)
        shutil.rmtree(_aside(staging), ignore_errors=True)
        _lock_of(staging).unlink(missing_ok=True)

    @contextmanager
    def batch_lock(self) -> Iterator[None]:
        """Keep every other batch out; raises StoreBusyError, naming the holder, or StoreError."""
        path = self.root / "lock"
        with store_errors(self.root):
            self.root.mkdir(parents=True, exist_ok=True)
            try:
                file = acquire_lock(path, wait=False)
            except BlockingIOError:
                holder = path.read_text(encoding="utf-8").strip()
                raise StoreBusyError(
                    self.root, f"held by another batch, {holder}", "wait for its end"
                ) from None
        with file:
            file.truncate(0)
            file.write(f"pid {os.getpid()} since {datetime.now(UTC):%Y-%m-%d %H:%M:%S} UTC\n")
            file.flush()
            yield

    @contextmanager
    def publish_lock(self) -> Iterator[None]:
        """Keep every other publish out, waiting for one that is under way; raises StoreError."""
        with store_errors(self.root):
            self.root.mkdir(parents=True, exist_ok=True)
            file = acquire_lock(self.root / "publish.lock", wait=True)
        with file:
            yield

    def append_manifest(self, event: str, **fields: object) -> None:
        """Add a line to manifest.jsonl: the time, what happened, and to what; raises StoreError."""
        line = json.dumps({"at": datetime.now(UTC).isoformat(), "event": event, **fields})
        with store_errors(self.root), (self.root / "manifest.jsonl").open("a", encoding="utf-8") as file:
            file.write(line + "\n")

    def _load(self, folder: Path) -> StoredFlight | None:
        try:
            content = (folder / _RESULT).read_bytes()
            value = json.loads(content)
            if value["result_version"] > RESULT_VERSION:
                raise StoreVersionError(folder / _RESULT, "written by a newer version", "upgrade lsnet-pipe")
            record = FlightRecord.from_json(value)
        except (FileNotFoundError, NotADirectoryError, KeyError, TypeError, ValueError):
            return None
        except OSError as error:
            raise explain_os_error(folder, error) from error
        return StoredFlight(folder, record, hashlib.sha256(content).hexdigest())


def _to_text(record: FlightRecord) -> str:
    return json.dumps(record.to_json(), indent=1) + "\n"


def _size_bytes(path: str) -> int | None:
    """Of a file, None of what is none; a string, since this is what looking at a large store waits for."""
    try:
        found = os.stat(path)  # noqa: PTH116
    except (FileNotFoundError, NotADirectoryError):
        return None
    return found.st_size if stat.S_ISREG(found.st_mode) else None


def _lock_of(staging: Path) -> Path:
    return staging.with_name(f"{staging.name}.lock")


def _aside(staging: Path) -> Path:
    return staging.with_name(f"{staging.name}.previous")
