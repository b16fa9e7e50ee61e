"""The schema of the index: migrations, settings of connections, and errors of DuckDB in one line."""

from __future__ import annotations

import hashlib
from datetime import UTC, datetime
from typing import TYPE_CHECKING

import duckdb

from inspect_pipeline.errors import StoreError
from inspect_pipeline.resources import MIGRATIONS, app_version, read_schema

if TYPE_CHECKING:
    from pathlib import Path

REBUILD = "run lsnet-pipe index rebuild"
BUSY = ("another program has it open for writing", "close it, or open it read-only there")
# Files of this storage version are read by DuckDB 1.5 and 2 alike.
CONFIG: dict[str, str | bool | int | float | list[str]] = {
    "storage_compatibility_version": "v1.5.0",
    "memory_limit": "128MB",
    "threads": "2",
    "python_enable_replacements": "false",
}
# What a damaged file may raise: DuckDB puts its bytes into messages, which need not be text.
DATABASE_ERRORS = (duckdb.Error, UnicodeDecodeError)


def index_error(path: Path, error: duckdb.Error | UnicodeDecodeError) -> StoreError:
    """Return the StoreError about an index that DuckDB cannot read."""
    if is_locked(error):
        return StoreError(path, *BUSY)
    return StoreError(path, f"cannot be read ({first_line(error)})", REBUILD)


def is_locked(error: duckdb.Error | UnicodeDecodeError) -> bool:
    """Whether another process has the database open for writing."""
    return isinstance(error, duckdb.IOException) and "Could not set lock" in str(error)


def first_line(error: duckdb.Error | UnicodeDecodeError) -> str:
    """Return the first line of a message of DuckDB."""
    return str(error).partition("\n")[0]


def create_tables(connection: duckdb.DuckDBPyConnection) -> None:
    """Apply the migrations that a database lacks, in one transaction."""
    applied = count_migrations(connection)
    connection.begin()
    for number, name in enumerate(MIGRATIONS[applied:], applied + 1):
        connection.execute(read_schema(name))
        connection.execute(
            "INSERT INTO schema_version VALUES (?, ?, ?)",
            [number, datetime.now(UTC).replace(tzinfo=None), app_version()],
        )
    connection.commit()


def table_names(connection: duckdb.DuckDBPyConnection) -> list[str]:
    """Return the names of all tables in order."""
    names = connection.execute("SELECT table_name FROM duckdb_tables() WHERE NOT internal ORDER BY 1")
    return [name for (name,) in names.fetchall()]


def count_migrations(connection: duckdb.DuckDBPyConnection) -> int:
    """Return how many migrations were applied to a database."""
    try:
        row = connection.execute("SELECT max(version) FROM schema_version").fetchone()
    except duckdb.CatalogException:
        return 0
    return int(row[0]) if row and row[0] else 0


def views_digest() -> str:
    """Return a hash of the definitions of the views."""
    return hashlib.sha256(read_schema("views.sql").encode()).hexdigest()


def has_views(connection: duckdb.DuckDBPyConnection) -> bool:
    """Whether a database has the views of this program."""
    row = connection.execute("SELECT sha256 FROM inputs WHERE name = 'views.sql'").fetchone()
    return row == (views_digest(),)
