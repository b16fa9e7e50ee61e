"""The rows of flights in the index: taken from their parquet files and records, and compared with them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import duckdb

from inspect_pipeline.index.derived import insert_records
from inspect_pipeline.index.flight_tables import ROW_TABLES

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from inspect_pipeline.store.store import StoredFlight

REBUILD = "run lsnet-pipe index rebuild"
# Files of this storage version are read by DuckDB 1.5 and 2 alike.
CONFIG: dict[str, str | bool | int | float | list[str]] = {
    "storage_compatibility_version": "v1.5.0",
    "memory_limit": "128MB",
    "threads": "2",
    "python_enable_replacements": "false",
}
_FLIGHTS_PER_INSERT = 256
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


def replace_rows(
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


def compare_rows(index_path: Path, flights: list[StoredFlight]) -> list[str]:
    """The flights whose rows in the index are not those of their parquet files."""
    problems = []
    try:
        with duckdb.connect(index_path, read_only=True, config=CONFIG) as connection:
            for table in ROW_TABLES if flights else ():
                if not (files := _row_files(flights, table)):
                    continue
                # What files of before a column was kept lack is NULL in the index.
                rows = f"((FROM {table} LIMIT 0) UNION ALL BY NAME FROM {_PARQUET})"
                expected = _digests(connection, table, rows, [files])
                found = _digests(connection, table, table, [])
                differing = [i for i, digest in expected.items() if found.get(i) != digest]
                problems += [f"{i}: other {table} in the index; {REBUILD}" for i in differing]
    except duckdb.Error as error:
        unreadable = find_unreadable(flights)
        problems += [f"{folder}: unreadable; process its recording again" for folder in unreadable]
        if not unreadable:
            problems.append(f"{index_path}: {str(error).splitlines()[0]}; {REBUILD}")
    return problems


def find_unreadable(flights: list[StoredFlight]) -> list[Path]:
    """The folders of the flights with a value in their parquet files that cannot be read."""
    folders = []
    with duckdb.connect(":memory:", config=CONFIG) as connection:
        for flight in flights:
            try:
                for table in ROW_TABLES:
                    if files := _row_files([flight], table):
                        connection.execute(f"SELECT bit_xor(hash(row)) FROM {_PARQUET} AS row", [files])
            except duckdb.Error:
                folders.append(flight.folder)
    return folders


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
