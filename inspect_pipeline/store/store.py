"""The store: one folder per flight, written whole or not at all, with locks and a log beside.

flights/<16 hex of flight_id>/   annotated.mcap, *.parquet and, last, result.json
spans.geojson, rules.toml        user input, as are reviews.jsonl and tags.jsonl: never derived
index.duckdb                     derived from all of these, see index/publish.py
manifest.jsonl                   a log, never read back
staging/                         flights being written
lock, publish.lock               held by `batch` and by a publish
"""

from __future__ import annotations

import json
import os
import re
import secrets
import shutil
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from inspect_pipeline.atomic import (
    acquire_lock,
    fsync_path,
    fsync_tree,
    move_folder_into_place,
    store_errors,
    undo_move_aside,
    write_whole,
)
from inspect_pipeline.errors import StoreBusyError, StoreWriteError
from inspect_pipeline.store.flight_folder import (
    RESULT,
    DamagedFlight,
    StoredFlight,
    file_sha256,
    find_problem,
    load_flight,
    result_text,
)
from inspect_pipeline.store.records import ANNOTATED, FlightRecord

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

_HOLDER = re.compile(r"pid \d+ since [\d :-]+ UTC")


def store_path(option: Path | None) -> Path:
    """Return the store's folder: the given one, else LSNET_PIPE_STORE, else ./inspections."""
    return option or Path(os.environ.get("LSNET_PIPE_STORE") or "inspections")


def as_store(store: Store | Path | str) -> Store:
    """Return a store, given as such or by its folder."""
    return store if isinstance(store, Store) else Store(store)


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
            (self.path / RESULT).write_text(result_text(complete), encoding="utf-8")
            fsync_path(self.path / RESULT)
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
        stored = load_flight(self.flight_dir(flight_id))
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
            stored = load_flight(folder)
            if problem := find_problem(folder, stored):
                damaged.append(DamagedFlight(folder, problem))
            elif stored:
                flights.append(stored)
        flights.sort(key=lambda stored: (stored.record.totals.start_ns or 0, stored.record.flight_id))
        return flights, damaged

    @contextmanager
    def lock_flight(self, flight_id: str, on_wait: Callable[[], object] = lambda: None) -> Iterator[None]:
        """Keep other processes from working on a flight; raises StoreError.

        Where one does, `on_wait` is called before waiting for its end.
        """
        path = self._staging / f"{self.flight_dir(flight_id).name}.lock"
        with store_errors(self.root):
            self._staging.mkdir(parents=True, exist_ok=True)
            try:
                lock = acquire_lock(path, wait=False)
            except BlockingIOError:
                on_wait()
                lock = acquire_lock(path, wait=True)
        with lock:
            try:
                yield
            finally:
                path.unlink(missing_ok=True)

    @contextmanager
    def write_flight(self, flight_id: str) -> Iterator[Staging]:
        """Yield a folder to write a flight in; without a commit it is removed after the block.

        Leftovers of killed processes are removed first. Raises StoreError, also for any OSError of the block:
        those of recordings are RecordingErrors.
        """
        with store_errors(self.root):
            self._flights.mkdir(parents=True, exist_ok=True)
            self._staging.mkdir(exist_ok=True)
        path = self._staging / f"{self.flight_dir(flight_id).name}-{secrets.token_hex(4)}"
        with self._own(path), store_errors(self.root):
            path.mkdir()
            yield Staging(path, self)

    def remove_annotated_copy(self, stored: StoredFlight) -> None:
        """Remove the annotated copy of a flight, after noting it in its record; raises StoreError.

        A flight that was replaced meanwhile keeps its own.
        """
        with store_errors(self.root), self.changing_flights():
            if load_flight(stored.folder) != stored:
                return
            if stored.record.annotations == ANNOTATED:
                record = stored.record.without_annotations()
                write_whole(stored.folder / RESULT, result_text(record))
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
                text = path.read_text(encoding="utf-8", errors="replace").strip()
                holder = f", {text}" if _HOLDER.fullmatch(text) else ""  # a power cut can tear it
                problem = f"held by another batch{holder}"
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


def _lock_of(staging: Path) -> Path:
    return staging.with_name(f"{staging.name}.lock")


def _aside(staging: Path) -> Path:
    return staging.with_name(f"{staging.name}.previous")
