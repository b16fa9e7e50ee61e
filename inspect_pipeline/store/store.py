"""The store: one folder per flight, written whole or not at all, with locks and a log beside.

flights/<16 hex of flight_id>/   annotated.mcap, *.parquet and, last, result.json
spans.geojson, rules.toml        user input, as are reviews.jsonl and tags.jsonl: never derived
index.duckdb                     derived from all of these, see index/publish.py
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
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

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
from inspect_pipeline.store.records import ANNOTATED, RESULT_VERSION, FlightRecord, parse_json

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

_RESULT = "result.json"


def store_path(option: Path | None) -> Path:
    """Return the store's folder: the given one, else LSNET_PIPE_STORE, else ./inspections."""
    return option or Path(os.environ.get("LSNET_PIPE_STORE") or "inspections")


def as_store(store: Store | Path | str) -> Store:
    """Return a store, given as such or by its folder."""
    return store if isinstance(store, Store) else Store(store)


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


@dataclass(frozen=True, slots=True)
class Staging:
    """A flight being written: fill the folder `path`, then commit."""

    path: Path
    _store: Store

    def commit(self, record: FlightRecord) -> Path:
        """Make the flight visible, replacing an older result of it, and return its folder.

        Everything is on the disk before result.json is written, and result.json before the folder
        gets its name. Sizes and checksums of the files are added to the record. Raises StoreError.
        """
        final = self._store.flight_dir(record.flight_id)
        with store_errors(self._store.root):
            files = {p.relative_to(self.path).as_posix(): p for p in self.path.rglob("*") if p.is_file()}
            fsync_tree(self.path)
            complete = replace(
                record,
                files={name: files[name].stat().st_size for name in sorted(files)},
                sha256={name: file_sha256(files[name]) for name in sorted(files)},
            )
            (self.path / _RESULT).write_text(_to_text(complete), encoding="utf-8")
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
    """The folder `root`; nothing is created before the first write.

    Raises StoreWriteError for a name that DuckDB would take for a pattern or for options.
    """

    def __init__(self, root: Path | str) -> None:
        self.root = Path(root).absolute()
        if re.search(r"[?*\\\n]", str(self.root)):
            problem = "a store cannot have a name with ? * \\ or a line end"
            raise StoreWriteError(self.root, problem, "use another folder")
        self.index_path = self.root / "index.duckdb"
        self._flights = self.root / "flights"
        self._staging = self.root / "staging"

    def flight_dir(self, flight_id: str) -> Path:
        """Return the folder of a flight, existing or not; raises ValueError unless given a sha256 in hex."""
        if not re.fullmatch(r"[0-9a-f]{64}", flight_id):
            raise ValueError(f"not a flight_id: {flight_id!r}")
        return self._flights / flight_id[:16]

    def find_flight(self, flight_id: str) -> StoredFlight | None:
        """Return a flight whose files are all there with their sizes, else None; raises StoreError."""
        stored = self._load(self.flight_dir(flight_id))
        return stored if stored and stored.check_sizes() is None else None

    def load_flight(self, flight_id: str) -> FlightRecord | None:
        """Return the record of a flight whose rows are undamaged, by their checksums, else None.

        Raises StoreError.
        """
        stored = self.find_flight(flight_id)
        with store_errors(self.root):
            return stored.record if stored and stored.check_content(stored.row_files) is None else None

    def scan(self) -> tuple[list[StoredFlight], list[DamagedFlight]]:
        """Return all flights by time, and the folders that cannot be used; raises StoreError.

        Sizes of files are checked, their content is not.
        """
        with store_errors(self.root):
            folders = sorted(self._flights.iterdir()) if self._flights.exists() else []
        flights, damaged = [], []
        for folder in folders:
            if folder.name.startswith("."):  # left by a file manager
                continue
            stored = self._load(folder)
            if problem := _find_problem(folder, stored):
                damaged.append(DamagedFlight(folder, problem))
            elif stored:
                flights.append(stored)
        flights.sort(key=lambda stored: (stored.record.totals.start_ns or 0, stored.record.flight_id))
        return flights, damaged

    @contextmanager
    def lock_flight(self, flight_id: str) -> Iterator[None]:
        """Keep other processes from working on a flight, waiting for one that does; raises StoreError."""
        path = self._staging / f"{self.flight_dir(flight_id).name}.lock"
        with store_errors(self.root):
            self._staging.mkdir(parents=True, exist_ok=True)
            lock = acquire_lock(path, wait=True)
        with lock:
            try:
                yield
            finally:
                path.unlink(missing_ok=True)

    @contextmanager
    def write_flight(self, flight_id: str) -> Iterator[Staging]:
        """Yield a folder to write a flight in; without a commit it is removed after the block.

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
        """Remove the annotated copy of a flight, after noting it in its record; raises StoreError.

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
        """Remove a flight in one step; raises StoreError."""
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
        """Keep other processes from adding or changing flights; raises OSError."""
        self._staging.mkdir(parents=True, exist_ok=True)
        with acquire_lock(self._staging / "mutex", wait=True):
            yield

    @contextmanager
    def _own(self, path: Path) -> Iterator[None]:
        """Hold the lock beside the staging folder `path`, which shows that its process is alive."""
        with store_errors(self.root), self.changing_flights():
            self._discard_dead()
            lock = acquire_lock(_lock_of(path), wait=False)
        with lock:
            try:
                yield
            finally:
                self._discard(path)

    def remove_leftovers(self) -> None:
        """Remove staging folders of dead processes; raises StoreError."""
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
        """Hold the lock of a batch; raises StoreBusyError, naming the holder, or StoreError."""
        path = self.root / "lock"
        with store_errors(self.root):
            self.root.mkdir(parents=True, exist_ok=True)
            try:
                file = acquire_lock(path, wait=False)
            except BlockingIOError:
                holder = path.read_text(encoding="utf-8", errors="replace").strip()
                problem = f"held by another batch, {holder}"
                raise StoreBusyError(self.root, problem, "wait until it ends") from None
        with file:
            file.truncate(0)
            file.write(f"pid {os.getpid()} since {datetime.now(UTC):%Y-%m-%d %H:%M:%S} UTC\n")
            file.flush()
            yield

    @contextmanager
    def publish_lock(self) -> Iterator[None]:
        """Hold the lock of a publish, waiting for one under way; raises StoreError."""
        with store_errors(self.root):
            self.root.mkdir(parents=True, exist_ok=True)
            file = acquire_lock(self.root / "publish.lock", wait=True)
        with file:
            yield

    def append_manifest(self, event: str, **fields: object) -> None:
        """Add a line to manifest.jsonl: time, event, fields; raises StoreError."""
        line = json.dumps({"at": datetime.now(UTC).isoformat(), "event": event, **fields})
        with store_errors(self.root), (self.root / "manifest.jsonl").open("a", encoding="utf-8") as file:
            file.write(line + "\n")

    def _load(self, folder: Path) -> StoredFlight | None:
        try:
            content = (folder / _RESULT).read_bytes()
            value = parse_json(content)
            if value["result_version"] > RESULT_VERSION:
                raise StoreVersionError(folder / _RESULT, "written by a newer version", "upgrade lsnet-pipe")
            record = FlightRecord.from_json(value)
        except (FileNotFoundError, NotADirectoryError, AttributeError, KeyError, TypeError, ValueError):
            return None
        except OSError as error:
            raise explain_os_error(folder, error) from error
        return StoredFlight(folder, record, hashlib.sha256(content).hexdigest())


def _to_text(record: FlightRecord) -> str:
    return json.dumps(record.to_json(), indent=1) + "\n"


def _find_problem(folder: Path, stored: StoredFlight | None) -> str | None:
    """Return a phrase about what is wrong with a folder among the flights."""
    if stored is None:
        return "its result.json is missing or cannot be read; process its recording again"
    name = stored.record.flight_id[:16]
    if name != folder.name:
        return f"a copy of flight {name} under another name; remove it, or rename it if that one is missing"
    problem = stored.check_sizes()
    return f"{problem}; process its recording again" if problem else None


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


def _lock_of(staging: Path) -> Path:
    return staging.with_name(f"{staging.name}.lock")


def _aside(staging: Path) -> Path:
    return staging.with_name(f"{staging.name}.previous")
