"""The index: one DuckDB file made from the flights of a store, replaced whole at every publish.

A publish works on a copy and renames it over the index. Readers keep the file they opened, never wait and
never see a part; a killed publish leaves the old index. The flights' result.json and parquet files are the
source of truth: an index that is missing, corrupt or behind is brought up to date from them.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from datetime import UTC
from typing import TYPE_CHECKING, Any

import duckdb

from inspect_pipeline.atomic import fsync_path, store_errors
from inspect_pipeline.errors import StoreError, StoreVersionError
from inspect_pipeline.index.inspected import input_digests
from inspect_pipeline.index.reading import open_index
from inspect_pipeline.index.rows import (
    find_damaged,
    find_unreadable,
    insert_checksums,
    insert_records,
    replace_rows,
)
from inspect_pipeline.index.schema import (
    CONFIG,
    DATABASE_ERRORS,
    REBUILD,
    count_migrations,
    create_tables,
    first_line,
    has_views,
    index_error,
    is_locked,
    table_names,
)
from inspect_pipeline.resources import MIGRATIONS, app_version, read_schema
from inspect_pipeline.store.runs import load_runs, run_rows
from inspect_pipeline.store.store import as_store

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from inspect_pipeline.index.inspected import Inspected
    from inspect_pipeline.inspection.rules import Rules
    from inspect_pipeline.store.flight_folder import DamagedFlight, StoredFlight
    from inspect_pipeline.store.store import Store

_HEADER_BYTES = 3 * 4096  # in front of the blocks


@dataclass(frozen=True, slots=True)
class IndexChange:
    """The outcome of a publish: flights in the index now, written and removed, and folders left out."""

    n_flights: int
    n_written: int
    n_removed: int
    damaged: tuple[DamagedFlight, ...]


def publish(store: Store | Path | str) -> IndexChange:
    """Bring the index up to date with the flights of the store; nothing is written when it already is.

    A missing or corrupt index is rebuilt. Raises StoreError, StoreVersionError.
    """
    store = as_store(store)
    with store.publish_lock():
        store.remove_leftovers()
        flights, damaged = store.scan()
        known = read_published(store.index_path)
        if known is None:
            return _rebuild(store, flights, damaged)
        wanted = {flight.record.flight_id: flight.result_sha256 for flight in flights}
        if known == wanted and _is_current(store, flights):
            return IndexChange(len(flights), 0, 0, tuple(damaged))
        try:
            return _replace_index(store, flights, damaged, known)
        except DATABASE_ERRORS:  # a corrupt block, of the index or of a flight
            return _rebuild(store, flights, damaged)


def rebuild(store: Store | Path | str) -> IndexChange:
    """Rebuild the index from the flights of the store; raises StoreError."""
    store = as_store(store)
    with store.publish_lock():
        store.remove_leftovers()
        return _rebuild(store, *store.scan())


def published_flights(store: Store) -> dict[str, str]:
    """Return the sha256 of the result.json of each flight in the index, {} without a readable index.

    Raises StoreVersionError.
    """
    return read_published(store.index_path) or {}


def inspect_again(store: Store, flight_ids: Sequence[str], rules: Rules) -> Inspected:
    """Return anomalies and coverage of flights by other rules, as rows of the tables; raises StoreError."""
    from inspect_pipeline.index.derived import inspect_flights  # noqa: PLC0415 - SciPy, half a second

    with open_index(store) as index:
        return inspect_flights(index.connection, store, flight_ids, rules)


def _is_current(store: Store, flights: list[StoredFlight]) -> bool:
    try:
        with duckdb.connect(store.index_path, read_only=True, config=CONFIG) as connection:
            return is_current(connection, store, flights)
    except DATABASE_ERRORS:  # a table is missing, or damaged
        return False


def is_current(connection: duckdb.DuckDBPyConnection, store: Store, flights: list[StoredFlight]) -> bool:
    """Whether the index is of this version of the program, with all runs and user input.

    Raises DATABASE_ERRORS.
    """
    if not (_is_of_this_program(connection) and _has_inputs_of(connection, store)):
        return False
    rows = connection.execute("SELECT run_id::VARCHAR, finished_at FROM runs").fetchall()
    found = {run_id: time and time.replace(tzinfo=UTC).isoformat() for run_id, time in rows}
    return found == {row["run_id"]: row["finished_at"] for row in _run_rows(store, flights)}


def _is_of_this_program(connection: duckdb.DuckDBPyConnection) -> bool:
    latest = "SELECT version, app_version FROM schema_version ORDER BY version DESC LIMIT 1"
    return connection.execute(latest).fetchone() == (len(MIGRATIONS), app_version())


def _has_inputs_of(connection: duckdb.DuckDBPyConnection, store: Store) -> bool:
    """Whether the inspection of the index is of today's rules, spans and user input."""
    found = dict(connection.execute("SELECT name, sha256 FROM inputs").fetchall())
    return bool(found == input_digests(store))


def _run_rows(store: Store, flights: list[StoredFlight]) -> list[dict[str, Any]]:
    return run_rows((flight.record.run for flight in flights), load_runs(store))


def read_published(path: Path, *, is_lock_error: bool = False) -> dict[str, str] | None:
    """Return the sha256 of the result.json of each flight in an index; None when it must be rebuilt.

    Raises StoreVersionError and, with `is_lock_error`, StoreError when another program is writing to it.
    """
    if not path.exists():
        return None
    try:
        with duckdb.connect(path, read_only=True, config=CONFIG) as connection:
            found = count_migrations(connection)
            if found > len(MIGRATIONS):
                problem = f"index version {found}, this program knows {len(MIGRATIONS)}"
                raise StoreVersionError(path, problem, "upgrade lsnet-pipe")
            if found == 0 or not _has_all_blocks(path, connection):
                return None
            return dict(connection.execute("SELECT flight_id, result_sha256 FROM flights").fetchall())
    except DATABASE_ERRORS as error:
        if is_lock_error and is_locked(error):
            raise index_error(path, error) from error
        return None


def _has_all_blocks(path: Path, connection: duckdb.DuckDBPyConnection) -> bool:
    """Whether the file holds every block in use: DuckDB misses one that was cut off only when it reads it.

    Free blocks at the end do not count, which DuckDB 2 removes.
    """
    blocks = " UNION ALL ".join(
        f"SELECT block_id FROM pragma_storage_info('{name}') WHERE persistent"
        for name in table_names(connection)
    )
    last, size = connection.execute(
        f"SELECT coalesce(max(block_id), -1), (SELECT block_size FROM pragma_database_size()) FROM ({blocks})"
    ).fetchall()[0]
    return path.stat().st_size >= _HEADER_BYTES + (int(last) + 1) * int(size)


def _rebuild(store: Store, flights: list[StoredFlight], damaged: list[DamagedFlight]) -> IndexChange:
    try:
        return _replace_index(store, flights, damaged, None)
    except DATABASE_ERRORS:
        unreadable = find_unreadable(flights)
    folders = {one.folder for one in unreadable}
    readable = [flight for flight in flights if flight.folder not in folders]
    try:
        return _replace_index(store, readable, [*damaged, *unreadable], None)
    except DATABASE_ERRORS as error:
        problem = f"cannot be written ({first_line(error)})"
        raise StoreError(store.index_path, problem, "check the space on the disk, then " + REBUILD) from error


def _replace_index(
    store: Store, flights: list[StoredFlight], damaged: list[DamagedFlight], known: Mapping[str, str] | None
) -> IndexChange:
    """Write the next index, from the current one with its `known` flights or from nothing, and rename it.

    Flights to be read whose checksums differ are left out. Raises DATABASE_ERRORS, StoreError.
    """
    path, following = store.index_path, store.index_path.with_name("index.duckdb.next")
    changed = [f for f in flights if known is None or known.get(f.record.flight_id) != f.result_sha256]
    with store_errors(path):
        damaged = [*damaged, *find_damaged(changed)]
    left_out = {one.folder for one in damaged}
    flights = [flight for flight in flights if flight.folder not in left_out]
    changed = [flight for flight in changed if flight.folder not in left_out]
    removed = set(known or ()) - {flight.record.flight_id for flight in flights}
    with store_errors(path):
        _remove_database(following)
        if known is not None:
            shutil.copyfile(path, following)
        with duckdb.connect(following, config=CONFIG) as connection:
            _write(connection, store, flights, changed, removed, is_new=known is None)
        fsync_path(following)
        # A log left by another program would be replayed into the new file.
        path.with_name("index.duckdb.wal").unlink(missing_ok=True)
        following.replace(path)
        fsync_path(path.parent)
    store.append_manifest("publish", n_flights=len(flights), n_written=len(changed), n_removed=len(removed))
    return IndexChange(len(flights), len(changed), len(removed), tuple(damaged))


def _write(
    connection: duckdb.DuckDBPyConnection,
    store: Store,
    flights: list[StoredFlight],
    changed: list[StoredFlight],
    removed: set[str],
    *,
    is_new: bool,
) -> None:
    """Bring an index up to date with `flights`, of which some have `changed`. Raises DATABASE_ERRORS."""
    keeps_views = not is_new and _is_of_this_program(connection) and has_views(connection)
    create_tables(connection)
    stale = [] if is_new else [*removed, *(flight.record.flight_id for flight in changed)]
    replace_rows(connection, stale, changed)
    connection.begin()  # else each of these statements would wait for the disk
    connection.execute("DELETE FROM runs")
    insert_records(connection, "INSERT INTO runs", "runs", _run_rows(store, flights))
    if changed or removed or not _has_inputs_of(connection, store):
        from inspect_pipeline.index.derived import refresh  # noqa: PLC0415 - SciPy, half a second

        refresh(connection, store, [flight.record.flight_id for flight in changed])
    if not keeps_views:  # they take as long as the rows of a short flight
        connection.execute(read_schema("views.sql"))
        connection.execute("UPDATE schema_version SET app_version = ?", [app_version()])
    insert_checksums(connection)
    connection.commit()
    connection.execute("CHECKPOINT")


def _remove_database(path: Path) -> None:
    """Remove a database with its log and its spilled blocks, as a killed publish leaves them."""
    for leftover in path.parent.glob(f"{path.name}*"):
        shutil.rmtree(leftover) if leftover.is_dir() else leftover.unlink()
