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
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

import duckdb

from inspect_pipeline.errors import StoreError, StoreVersionError
from inspect_pipeline.files import fsync_path, store_errors
from inspect_pipeline.index_inspection import input_digests, insert_records, inspect_flights, refresh
from inspect_pipeline.resources import MIGRATIONS, read_schema
from inspect_pipeline.runs import load_runs, run_rows
from inspect_pipeline.tables import ROW_TABLES, count_migrations, create_tables

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from inspect_pipeline.index_inspection import Inspected
    from inspect_pipeline.rules import Rules
    from inspect_pipeline.store import Store, StoredFlight

_FLIGHTS_PER_INSERT = 256
_HEADER_BYTES = 3 * 4096  # in front of the blocks

# Files of this storage version are read by DuckDB 1.5 and 2 alike.
_CONFIG: dict[str, str | bool | int | float | list[str]] = {
    "storage_compatibility_version": "v1.5.0",
    "memory_limit": "128MB",
    "threads": "2",
    "python_enable_replacements": "false",
}
# Folders of a store may be called line=L12, which says nothing about columns.
_PARQUET = "read_parquet(?, union_by_name := true, hive_partitioning := false)"
_SET_CHANNEL_TIMES = f"""
UPDATE channels SET first_ns = f.first_ns, last_ns = f.last_ns
FROM (
    SELECT flight_id, channel_id, min(log_time_ns) AS first_ns, max(log_time_ns) AS last_ns
    FROM {_PARQUET}
    GROUP BY ALL
) AS f
WHERE channels.flight_id = f.flight_id AND channels.channel_id = f.channel_id
"""
_REBUILD = "run lsnet-pipe index rebuild"


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
        with duckdb.connect(path, read_only=True, config=_CONFIG) as connection:
            if count_migrations(connection) != len(MIGRATIONS):
                raise StoreVersionError(path, "the index is of another version", _REBUILD)
            yield connection
    except duckdb.Error as error:
        raise StoreError(path, f"cannot be read ({str(error).splitlines()[0]})", _REBUILD) from error


def verify(store: Store) -> tuple[str, ...]:
    """What differs between the index and the flights of the store, a sentence each; every value is compared.

    Raises StoreError, StoreVersionError.
    """
    with store.publish_lock():
        flights, damaged = _whole_flights(store)
        problems = [f"{folder}: damaged; process its recording again" for folder in damaged]
        known = _published(store.index_path)
        if known is None:
            return (*problems, f"{store.index_path}: missing or corrupt; {_REBUILD}")
        wanted = {flight.record.flight_id: flight for flight in flights}
        problems += [f"{flight_id}: in the index only; {_REBUILD}" for flight_id in known.keys() - wanted]
        problems += [f"{flight_id}: not in the index; {_REBUILD}" for flight_id in wanted.keys() - known]
        same = {i: f for i, f in wanted.items() if known.get(i) == f.result_sha256}
        problems += [f"{i}: older in the index; {_REBUILD}" for i in (wanted.keys() & known) - same.keys()]
        problems += _compare_rows(store.index_path, list(same.values()))
        if not problems and not _is_current(store, flights):
            problems.append(f"{store.index_path}: other runs, spans or rules, or another version; {_REBUILD}")
        return tuple(problems)


def _is_current(store: Store, flights: list[StoredFlight]) -> bool:
    """Whether a readable index is of this version of the program, with all runs and what people told."""
    with duckdb.connect(store.index_path, read_only=True, config=_CONFIG) as connection:
        latest = "SELECT version, app_version FROM schema_version ORDER BY version DESC LIMIT 1"
        if connection.execute(latest).fetchone() != (len(MIGRATIONS), version("lsnet-pipe")):
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
        with duckdb.connect(path, read_only=True, config=_CONFIG) as connection:
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
        unreadable = _unreadable(flights)
    readable = [flight for flight in flights if flight.folder not in unreadable]
    try:
        return _replace_index(store, readable, [*damaged, *unreadable], None)
    except duckdb.Error as error:
        problem = f"cannot be made ({str(error).splitlines()[0]})"
        raise StoreError(
            store.index_path, problem, "check the space on the disk, then " + _REBUILD
        ) from error


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
        with duckdb.connect(following, config=_CONFIG) as connection:
            create_tables(connection)
            _replace_rows(connection, [*removed, *(flight.record.flight_id for flight in changed)], changed)
            connection.execute("DELETE FROM runs")
            insert_records(connection, "INSERT INTO runs", "runs", _run_rows(store, flights))
            refresh(connection, store, [flight.record.flight_id for flight in changed])
            connection.execute(read_schema("views.sql"))
            connection.execute("UPDATE schema_version SET app_version = ?", [version("lsnet-pipe")])
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


def _replace_rows(
    connection: duckdb.DuckDBPyConnection, removed: list[str], flights: list[StoredFlight]
) -> None:
    """Remove the rows of some flights and insert those of others, in one transaction."""
    connection.begin()
    for table in ("flights", "channels", *ROW_TABLES):
        connection.execute(f"DELETE FROM {table} WHERE flight_id IN (SELECT unnest(?))", [removed])
    for start in range(0, len(flights), _FLIGHTS_PER_INSERT):
        _insert_flights(connection, flights[start : start + _FLIGHTS_PER_INSERT])
    connection.execute("DELETE FROM models WHERE model_id NOT IN (SELECT model_id FROM flights)")
    connection.commit()


def _insert_flights(connection: duckdb.DuckDBPyConnection, flights: Sequence[StoredFlight]) -> None:
    for table in ROW_TABLES:
        if files := _row_files(flights, table):
            connection.execute(f"INSERT INTO {table} BY NAME SELECT * FROM {_PARQUET}", [files])
    records = {flight.result_sha256: flight.record.to_json() for flight in flights}
    models = {record["model"]["model_id"]: record["model"] for record in records.values()}
    channels = [
        {"flight_id": record["flight_id"], **channel}
        for record in records.values()
        for channel in record["channels"]
    ]
    insert_records(connection, "INSERT OR REPLACE INTO models", "models", list(models.values()))
    insert_records(connection, "INSERT INTO flights", "flights", [_flight_row(*r) for r in records.items()])
    insert_records(connection, "INSERT INTO channels", "channels", channels)
    connection.execute(_SET_CHANNEL_TIMES, [_row_files(flights, "frames")])


def _flight_row(result_sha256: str, record: dict[str, Any]) -> dict[str, Any]:
    own = ("flight_id", "source_uri", "source_bytes", "status", "reason", "ingested_at")
    return {
        **{name: record[name] for name in own},
        **record["totals"],
        "run_id": record["run"]["run_id"],
        "model_id": record["model"]["model_id"],
        "config_sha256": record["run"]["config_sha256"],
        "result_sha256": result_sha256,
    }


def _row_files(flights: Iterable[StoredFlight], table: str) -> list[str]:
    """The files of a table; flights of before it was kept have none."""
    name = f"{table}.parquet"
    return [str(flight.folder / name) for flight in flights if name in flight.record.files]


def _compare_rows(index_path: Path, flights: list[StoredFlight]) -> list[str]:
    """The flights whose rows in the index are not those of their parquet files."""
    problems = []
    try:
        with duckdb.connect(index_path, read_only=True, config=_CONFIG) as connection:
            for table in ROW_TABLES if flights else ():
                if not (files := _row_files(flights, table)):
                    continue
                # What files of before a column was kept lack is NULL in the index.
                rows = f"((FROM {table} LIMIT 0) UNION ALL BY NAME FROM {_PARQUET})"
                expected = _digests(connection, table, rows, [files])
                found = _digests(connection, table, table, [])
                differing = [i for i, digest in expected.items() if found.get(i) != digest]
                problems += [f"{i}: other {table} in the index; {_REBUILD}" for i in differing]
    except duckdb.Error as error:
        unreadable = _unreadable(flights)
        problems += [f"{folder}: unreadable; process its recording again" for folder in unreadable]
        if not unreadable:
            problems.append(f"{index_path}: {str(error).splitlines()[0]}; {_REBUILD}")
    return problems


def _digests(
    connection: duckdb.DuckDBPyConnection, table: str, source: str, values: list[list[str]]
) -> dict[str, tuple[int, int]]:
    """The number of rows and a hash of all their values, per flight of `source`, which is like `table`."""
    described = connection.execute(f"DESCRIBE {table}").fetchall()
    columns = ", ".join(name for name, *_ in described if not name.endswith("_utc"))
    rows = connection.execute(
        f"SELECT flight_id, count(*), bit_xor(hash({columns})) FROM {source} GROUP BY flight_id",
        values,
    ).fetchall()
    return {flight_id: (count, digest) for flight_id, count, digest in rows}


def _unreadable(flights: list[StoredFlight]) -> list[Path]:
    """The folders of the flights with a value in their parquet files that cannot be read."""
    folders = []
    with duckdb.connect(":memory:", config=_CONFIG) as connection:
        for flight in flights:
            try:
                for table in ROW_TABLES:
                    files = _row_files([flight], table)
                    connection.execute(f"SELECT bit_xor(hash(row)) FROM {_PARQUET} AS row", [files])
            except duckdb.Error:
                folders.append(flight.folder)
    return folders
