"""The rows of flights in the index: copied from their parquet files and records, and compared with them."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import duckdb

from inspect_pipeline.index.flight_tables import ROW_TABLES
from inspect_pipeline.index.schema import CONFIG, DATABASE_ERRORS, REBUILD, create_tables, table_names
from inspect_pipeline.store.flight_folder import DamagedFlight

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from inspect_pipeline.store.flight_folder import StoredFlight

PROCESS_AGAIN = "process its recording again"
_FLIGHTS_PER_INSERT = 256
# A folder of a store may have a name like line=L12, which is no hive partition.
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


def insert_records(
    connection: duckdb.DuckDBPyConnection, insert: str, table: str, rows: list[dict[str, Any]]
) -> None:
    """Insert rows whose keys are columns of `table`, in one statement; their types are the table's."""
    if not rows:
        return
    described = connection.execute(f"DESCRIBE {table}").fetchall()
    shape = {name: kind for name, kind, *_ in described if name in rows[0]}
    # File names and command-line arguments may contain bytes that are not text.
    text = json.dumps(rows, ensure_ascii=False).encode(errors="replace").decode()
    connection.execute(
        f"{insert} BY NAME SELECT unnest(row) FROM (SELECT unnest(from_json(?, ?)) AS row)",
        [text, json.dumps([shape])],
    )


def replace_rows(
    connection: duckdb.DuckDBPyConnection, removed: list[str], flights: list[StoredFlight]
) -> None:
    """Delete the rows of some flights and insert those of others, in one transaction."""
    connection.begin()
    for table in ("flights", "channels", *ROW_TABLES) if removed else ():
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
    """Return the files of a table; flights of older versions may have none."""
    name = f"{table}.parquet"
    return [str(flight.folder / name) for flight in flights if name in flight.record.files]


def compare_rows(connection: duckdb.DuckDBPyConnection, flights: list[StoredFlight]) -> list[str]:
    """Return a sentence about each flight whose rows in the index differ from its parquet files.

    Raises DATABASE_ERRORS for an index that cannot be read.
    """
    problems = []
    try:
        for table in ROW_TABLES if flights else ():
            if not (files := _row_files(flights, table)):
                continue
            # A column that files of older versions lack is NULL in the index.
            rows = f"((FROM {table} LIMIT 0) UNION ALL BY NAME FROM {_PARQUET})"
            expected = _digests(connection, table, rows, [files])
            found = _digests(connection, table, table, [])
            differing = [i for i, digest in expected.items() if found.get(i) != digest]
            problems += [f"{i}: {table} in the index differ from the flight's; {REBUILD}" for i in differing]
    except DATABASE_ERRORS:
        unreadable = find_unreadable(flights)
        if not unreadable:
            raise
        problems += [f"{one.folder}: {one.problem}" for one in unreadable]
    return problems


def find_damaged(
    flights: Iterable[StoredFlight],
    files_of: Callable[[StoredFlight], Iterable[str]] = lambda flight: flight.row_files,
) -> list[DamagedFlight]:
    """Return the flights with a file, else with rows, whose checksum differs; raises OSError."""
    damaged = []
    for flight in flights:
        if problem := flight.check_content(files_of(flight)):
            # Only rows are checked before a recording counts as done.
            by_force = "" if flight.check_content(flight.row_files) else " with --force"
            damaged.append(DamagedFlight(flight.folder, f"{problem}; {PROCESS_AGAIN}{by_force}"))
    return damaged


def find_unreadable(flights: list[StoredFlight]) -> list[DamagedFlight]:
    """Return the flights that cannot be inserted into an empty index, trying them one by one."""
    damaged = []
    for flight in flights:
        try:
            with duckdb.connect(":memory:", config=CONFIG) as connection:
                create_tables(connection)
                _insert_flights(connection, [flight])
        except (*DATABASE_ERRORS, AttributeError, KeyError, TypeError, ValueError) as error:
            damaged.append(
                DamagedFlight(flight.folder, f"unreadable ({str(error)[:200]!a}); {PROCESS_AGAIN}")
            )
    return damaged


def insert_checksums(connection: duckdb.DuckDBPyConnection) -> None:
    """Store a checksum of every table whose rows cannot be compared with the flights' files."""
    connection.execute("DELETE FROM checksums")
    tables = [name for name in table_names(connection) if name not in (*ROW_TABLES, "checksums")]
    connection.execute(f"INSERT INTO checksums {_checksums(tables)}")


def compare_checksums(connection: duckdb.DuckDBPyConnection) -> list[str]:
    """Return the tables with other rows than were published; raises DATABASE_ERRORS."""
    published = connection.execute("FROM checksums WHERE duckdb_version = ?", [duckdb.__version__]).fetchall()
    tables = [table for table, *_ in published]
    found = connection.execute(_checksums(tables)).fetchall() if tables else []
    return sorted(table for table, *_ in set(published) - set(found))


def _checksums(tables: list[str]) -> str:
    """Return the query for the rows of `checksums`: sums of hashes, so that order does not matter."""
    return " UNION ALL ".join(
        f"SELECT '{table}', count(*), coalesce(sum(hash(row)), 0)::VARCHAR, '{duckdb.__version__}'"
        f" FROM {table} AS row"
        for table in tables
    )


def _digests(
    connection: duckdb.DuckDBPyConnection, table: str, source: str, values: list[list[str]]
) -> dict[str, tuple[int, int]]:
    """Return the number of rows and a hash of their values per flight of `source`, shaped like `table`."""
    described = connection.execute(f"DESCRIBE {table}").fetchall()
    columns = ", ".join(name for name, *_ in described if not name.endswith("_utc"))
    rows = connection.execute(
        f"SELECT flight_id, count(*), bit_xor(hash({columns})) FROM {source} GROUP BY flight_id",
        values,
    ).fetchall()
    return {flight_id: (count, digest) for flight_id, count, digest in rows}
