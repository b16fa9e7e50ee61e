"""The index: one DuckDB file made from the flights of a store, replaced whole at every publish.

A publish works on a copy and renames it over the index. Readers keep the file they opened, are never kept
waiting and never see half; a killed publish leaves the old index. The flights' result.json and parquet
files are the truth: an index that is missing, corrupt or behind is brought up to them.
"""

from __future__ import annotations

import shutil
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC
from typing import TYPE_CHECKING, Any

import duckdb

from inspect_pipeline.atomic import fsync_path, store_errors
from inspect_pipeline.errors import StoreError, StoreVersionError
from inspect_pipeline.index.derived import input_digests, insert_records, inspect_flights, refresh
from inspect_pipeline.index.flight_tables import count_migrations, create_tables
from inspect_pipeline.index.rows import CONFIG, REBUILD, compare_rows, find_unreadable, replace_rows
from inspect_pipeline.resources import MIGRATIONS, app_version, read_schema
from inspect_pipeline.store.runs import load_runs, run_rows

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from inspect_pipeline.index.derived import Inspected
    from inspect_pipeline.inspection.rules import Rules
    from inspect_pipeline.store.store import Store, StoredFlight

_HEADER_BYTES = 3 * 4096  # in front of the blocks


@dataclass(frozen=True, slots=True)
class IndexChange:
    """What a publish did: flights in the index now, written, removed, and damaged folders left out."""

    n_flights: int
    n_written: int
    n_removed: int
    damaged: tuple[Path, ...]


def publish(store: Store) -> IndexChange:
    """Bring the index up to the flights of the store; nothing is written when it already is.

    A missing or corrupt index is made anew. Raises StoreError, StoreVersionError.
    """
    with store.publish_lock():
        store.remove_leftovers()
        flights, damaged = _whole_flights(store)
        known = _published(store.index_path)
        if known is None:
            return _rebuild(store, flights, damaged)
        wanted = {flight.record.flight_id: flight.result_sha256 for flight in flights}
        if known == wanted and _is_current(store, flights):
            return IndexChange(len(flights), 0, 0, tuple(damaged))
        try:
            return _replace_index(store, flights, damaged, known)
        except duckdb.Error:  # a corrupt block, of the index or of a flight
            return _rebuild(store, flights, damaged)


def rebuild(store: Store) -> IndexChange:
    """Make the index anew from the flights of the store; raises StoreError."""
    with store.publish_lock():
        store.remove_leftovers()
        return _rebuild(store, *_whole_flights(store))


def select(store: Store, sql: str, values: Sequence[Any] = ()) -> list[dict[str, Any]]:
    """The rows of a statement of this program's own, by name; that of people goes to query.py.

    Raises StoreError when there is no index, or none that can be read.
    """
    with _reading(store) as connection:
        cursor = connection.execute(sql, list(values))
        names = [column[0] for column in cursor.description or ()]
        return [dict(zip(names, row, strict=True)) for row in cursor.fetchall()]


def inspect_again(store: Store, flight_ids: Sequence[str], rules: Rules) -> Inspected:
    """Anomalies and coverage of flights by other rules, as rows of the tables; raises StoreError."""
    with _reading(store) as connection:
        return inspect_flights(connection, store, flight_ids, rules)


@contextmanager
def _reading(store: Store) -> Iterator[duckdb.DuckDBPyConnection]:
    path = store.index_path
    if not path.exists():
        raise StoreError(store.root, "there is no index", "run lsnet-pipe process first")
    try:
        with duckdb.connect(path, read_only=True, config=CONFIG) as connection:
            if count_migrations(connection) != len(MIGRATIONS):
                raise StoreVersionError(path, "the index is of another version", REBUILD)
            yield connection
    except duckdb.Error as error:
        raise StoreError(path, f"cannot be read ({str(error).splitlines()[0]})", REBUILD) from error


def verify(store: Store) -> tuple[str, ...]:
    """What differs between the index and the flights of the store, a sentence each; every value is compared.

    Raises StoreError, StoreVersionError.
    """
    with store.publish_lock():
        flights, damaged = _whole_flights(store)
        problems = [f"{folder}: damaged; process its recording again" for folder in damaged]
        known = _published(store.index_path)
        if known is None:
            return (*problems, f"{store.index_path}: missing or corrupt; {REBUILD}")
        wanted = {flight.record.flight_id: flight for flight in flights}
        problems += [f"{flight_id}: in the index only; {REBUILD}" for flight_id in known.keys() - wanted]
        problems += [f"{flight_id}: not in the index; {REBUILD}" for flight_id in wanted.keys() - known]
        same = {i: f for i, f in wanted.items() if known.get(i) == f.result_sha256}
        problems += [f"{i}: older in the index; {REBUILD}" for i in (wanted.keys() & known) - same.keys()]
        problems += compare_rows(store.index_path, list(same.values()))
        if not problems and not _is_current(store, flights):
            problems.append(f"{store.index_path}: other runs, spans or rules, or another version; {REBUILD}")
        return tuple(problems)


def _is_current(store: Store, flights: list[StoredFlight]) -> bool:
    """Whether an index is of this version of the program, with all runs and what people told."""
    try:
        return _is_up_to_date(store, flights)
    except duckdb.Error:  # a table is missing, or damaged
        return False


def _is_up_to_date(store: Store, flights: list[StoredFlight]) -> bool:
    """The same of one that can be read; raises duckdb.Error."""
    with duckdb.connect(store.index_path, read_only=True, config=CONFIG) as connection:
        latest = "SELECT version, app_version FROM schema_version ORDER BY version DESC LIMIT 1"
        if connection.execute(latest).fetchone() != (len(MIGRATIONS), app_version()):
            return False
        if dict(connection.execute("SELECT name, sha256 FROM inputs").fetchall()) != input_digests(store):
            return False
        rows = connection.execute("SELECT run_id::VARCHAR, finished_at FROM runs").fetchall()
    found = {run_id: time and time.replace(tzinfo=UTC).isoformat() for run_id, time in rows}
    return found == {row["run_id"]: row["finished_at"] for row in _run_rows(store, flights)}


def _run_rows(store: Store, flights: list[StoredFlight]) -> list[dict[str, Any]]:
    return run_rows((flight.record.run for flight in flights), load_runs(store))


def _whole_flights(store: Store) -> tuple[list[StoredFlight], list[Path]]:
    """The flights whose files are as result.json says, and the folders of the others."""
    flights, damaged = store.scan()
    cut = [flight.folder for flight in flights if not flight.is_whole()]
    return [flight for flight in flights if flight.folder not in cut], [*damaged, *cut]


def _published(path: Path) -> dict[str, str] | None:
    """The sha256 of the result.json of each flight in an index; None when it must be made anew.

    Raises StoreVersionError.
    """
    if not path.exists():
        return None
    try:
        with duckdb.connect(path, read_only=True, config=CONFIG) as connection:
            found = count_migrations(connection)
            if found > len(MIGRATIONS):
                problem = f"index version {found}, this program knows {len(MIGRATIONS)}"
                raise StoreVersionError(path, problem, "upgrade lsnet-pipe")
            if found == 0 or path.stat().st_size < _size_bytes(connection):
                return None
            return dict(connection.execute("SELECT flight_id, result_sha256 FROM flights").fetchall())
    except duckdb.Error:
        return None


def _size_bytes(connection: duckdb.DuckDBPyConnection) -> int:
    """How large the file of a database must be; DuckDB reads one that was cut, until a block is missing."""
    row = connection.execute("SELECT total_blocks * block_size FROM pragma_database_size()").fetchone()
    return _HEADER_BYTES + int(row[0]) if row else 0


def _rebuild(store: Store, flights: list[StoredFlight], damaged: list[Path]) -> IndexChange:
    try:
        return _replace_index(store, flights, damaged, None)
    except duckdb.Error:
        unreadable = find_unreadable(flights)
    readable = [flight for flight in flights if flight.folder not in unreadable]
    try:
        return _replace_index(store, readable, [*damaged, *unreadable], None)
    except duckdb.Error as error:
        problem = f"cannot be made ({str(error).splitlines()[0]})"
        raise StoreError(store.index_path, problem, "check the space on the disk, then " + REBUILD) from error


def _replace_index(
    store: Store, flights: list[StoredFlight], damaged: list[Path], known: Mapping[str, str] | None
) -> IndexChange:
    """Write the next index, from the current one with its `known` flights or from nothing, and rename it.

    Raises duckdb.Error, StoreError.
    """
    path, following = store.index_path, store.index_path.with_name("index.duckdb.next")
    changed = [f for f in flights if known is None or known.get(f.record.flight_id) != f.result_sha256]
    removed = set(known or ()) - {flight.record.flight_id for flight in flights}
    with store_errors(path):
        _remove_database(following)
        if known is not None:
            shutil.copyfile(path, following)
        with duckdb.connect(following, config=CONFIG) as connection:
            create_tables(connection)
            replace_rows(connection, [*removed, *(flight.record.flight_id for flight in changed)], changed)
            connection.begin()  # one by one, each of these statements would wait for the disk
            connection.execute("DELETE FROM runs")
            insert_records(connection, "INSERT INTO runs", "runs", _run_rows(store, flights))
            refresh(connection, store, [flight.record.flight_id for flight in changed])
            connection.execute(read_schema("views.sql"))
            connection.execute("UPDATE schema_version SET app_version = ?", [app_version()])
            connection.commit()
            connection.execute("CHECKPOINT")
        fsync_path(following)
        # Not ours, but a log left by someone's own DuckDB would be replayed into the new file.
        path.with_name("index.duckdb.wal").unlink(missing_ok=True)
        following.replace(path)
        fsync_path(path.parent)
    store.append_manifest("publish", n_flights=len(flights), n_written=len(changed), n_removed=len(removed))
    return IndexChange(len(flights), len(changed), len(removed), tuple(damaged))


def _remove_database(path: Path) -> None:
    """Remove a database with its log and its spilled blocks, left by a killed publish."""
    for leftover in path.parent.glob(f"{path.name}*"):
        shutil.rmtree(leftover) if leftover.is_dir() else leftover.unlink()
