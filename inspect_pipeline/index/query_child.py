"""The child process of query.py: limits itself, runs one reading statement, writes the rows to stdout.

Started as a script with a job in JSON on stdin. It imports little, to start quickly.
Ends with 0, or with 1 and one JSON object on stderr: {"kind": KIND, "message": ...}, where KIND is query,
store, busy or version.
"""

from __future__ import annotations

import csv
import json
import os
import re
import resource
import sys
from itertools import chain
from typing import TYPE_CHECKING, Any, NoReturn

from inspect_pipeline.index.query_output import QueryRows, write_json, write_table

if TYPE_CHECKING:
    from collections.abc import Iterator

    import duckdb

    from inspect_pipeline.index.query_output import Row

_BATCH_ROWS = 2048
_OVERHEAD_BYTES = 3 << 29  # address space of Python, DuckDB and their threads
_MAX_PARQUET_BYTES = 64 << 30
_COPY_OPTIONS = {"csv": "FORMAT csv, HEADER", "parquet": "FORMAT parquet, COMPRESSION zstd"}
_EXPLAIN = re.compile(r"\s*EXPLAIN\b(\s+ANALYZE\b)?(.*)", re.IGNORECASE | re.DOTALL)
_ONE_STATEMENT = "one SELECT, WITH, EXPLAIN, DESCRIBE, SHOW or SUMMARIZE statement is allowed"

_CONFIG = {
    "threads": "2",
    "autoinstall_known_extensions": "false",
    "autoload_known_extensions": "false",
    "allow_community_extensions": "false",
    "allow_unsigned_extensions": "false",
    "python_enable_replacements": "false",
    "temp_directory": "",
    "max_temp_directory_size": "0B",
}


def main() -> None:
    """Run the job read from stdin."""
    job = json.load(sys.stdin)
    limit_process(job)
    import duckdb  # noqa: PLC0415 - after the limits

    try:
        connection = open_index(job)
    except (duckdb.Error, UnicodeError) as error:
        fail("busy" if "Could not set lock" in str(error) else "store", one_line(error))
    try:
        check_statement(job["sql"])
        run_statement(connection, job)
        sys.stdout.flush()
        os._exit(0)  # saves the time to shut interpreter and database down
    except (MemoryError, duckdb.OutOfMemoryException):
        fail("query", f"it needs more than {job['memory_bytes'] >> 20} MiB of memory; narrow the query")
    except (duckdb.Error, UnicodeError) as error:
        fail("query", one_line(error))
    except BrokenPipeError:
        os._exit(0)


def limit_process(job: dict[str, Any]) -> None:
    """Bound address space, processor time and written files; no core dumps."""
    file_bytes = _MAX_PARQUET_BYTES if job["format"] == "parquet" else 0
    for what, limit in (
        (resource.RLIMIT_AS, job["memory_bytes"] + _OVERHEAD_BYTES),
        (resource.RLIMIT_CPU, job["cpu_s"]),
        (resource.RLIMIT_FSIZE, file_bytes),
        (resource.RLIMIT_CORE, 0),
    ):
        hard = resource.getrlimit(what)[1]  # as of `ulimit`: nobody but root may raise it
        allowed = limit if hard == resource.RLIM_INFINITY else min(limit, hard)
        resource.setrlimit(what, (allowed, allowed))


def open_index(job: dict[str, Any]) -> duckdb.DuckDBPyConnection:
    """Open the index read-only, then lock out the file system and settings; raises duckdb.Error."""
    import duckdb  # noqa: PLC0415 - after the limits

    config: dict[str, str | bool | int | float | list[str]] = {
        **_CONFIG,
        "memory_limit": f"{job['memory_bytes'] >> 20}MiB",
    }
    connection = duckdb.connect(job["index_path"], read_only=True, config=config)
    row = connection.execute("SELECT max(version) FROM schema_version").fetchone()
    if row and row[0] > job["version"]:
        fail("version", f"index version {row[0]}, this program knows {job['version']}")
    connection.execute("SET TimeZone = 'UTC'")
    if job["format"] in _COPY_OPTIONS:
        connection.execute(f"SET allowed_paths = [{quote(job['copy_path'])}]")
    if not job["allow_files"]:
        connection.execute("SET enable_external_access = false")
    connection.execute("SET lock_configuration = true")
    return connection


def check_statement(sql: str) -> None:
    """Refuse all but one reading statement; raises duckdb.Error for what cannot be parsed."""
    import duckdb  # noqa: PLC0415 - after the limits

    kinds = [str(statement.type).rpartition(".")[2] for statement in duckdb.extract_statements(sql)]
    if kinds not in (["SELECT"], ["EXPLAIN"]):
        fail("query", f"{_ONE_STATEMENT}, not {', '.join(kinds) or 'an empty text'}")


def run_statement(connection: duckdb.DuckDBPyConnection, job: dict[str, Any]) -> None:
    """Write the rows of a checked statement as the job asks; raises duckdb.Error.

    The table function query() takes the statement: it is DuckDB's own guarantee of a single SELECT.
    """
    source = f"query({quote(job['sql'])})"
    explain = _EXPLAIN.fullmatch(job["sql"])
    if explain and job["format"] != "parquet":
        statement = f"EXPLAIN{explain[1] or ''} SELECT * FROM query({quote(explain[2])})"
        write_plan(connection.execute(statement).fetchall(), job)
    elif job["format"] in _COPY_OPTIONS:
        target = f"{quote(job['copy_path'])} ({_COPY_OPTIONS[job['format']]}, USE_TMP_FILE false)"
        rows = select_csv(connection, source) if job["format"] == "csv" else f"FROM {source}"
        connection.execute(f"COPY ({rows}) TO {target}")
    elif job["format"] == "arrow":
        write_arrow(connection, source)
    elif job["format"] == "json":
        write_json(select_objects(connection, source), sys.stdout)
    else:
        write_table(
            select_texts(connection, source),
            sys.stdout,
            is_shortened=job["is_shortened"],
            max_rows=job["max_rows"],
            width=job["width"],
        )


def write_arrow(connection: duckdb.DuckDBPyConnection, source: str) -> None:
    """Write the rows of `source` as an Arrow IPC stream."""
    import pyarrow as pa  # noqa: PLC0415 - the other formats do without

    rows = connection.sql(f"FROM {source}")
    with (
        rows.to_arrow_reader(_BATCH_ROWS) as reader,
        pa.ipc.new_stream(sys.stdout.buffer, reader.schema) as writer,
    ):
        for batch in reader:
            writer.write_batch(batch)


def select_texts(connection: duckdb.DuckDBPyConnection, source: str) -> QueryRows:
    """Return the rows of `source` with every cell cast to text by DuckDB."""
    names, types = describe(connection, source)
    columns = [f"c{number}" for number in range(len(names))]
    cells = ", ".join(
        f"CAST({time_as_text(column, kind)} AS VARCHAR)" for column, kind in zip(columns, types, strict=True)
    )
    connection.execute(f"SELECT {cells} FROM {source} AS t({', '.join(columns)})")
    return QueryRows(names, types, iter_rows(connection))


def select_objects(connection: duckdb.DuckDBPyConnection, source: str) -> Iterator[str]:
    """Return the rows of `source` as JSON objects, which may contain NaN and Infinity."""
    names, types = describe(connection, source)
    columns = [f"c{number}" for number in range(len(names))]
    cells = (time_as_text(column, kind) for column, kind in zip(columns, types, strict=True))
    pairs = ", ".join(f"{quote(name)}, {cell}" for name, cell in zip(names, cells, strict=True))
    connection.execute(
        f"SELECT CAST(json_object({pairs}) AS VARCHAR) FROM {source} AS t({', '.join(columns)})"
    )
    return (row[0] or "null" for row in iter_rows(connection))


def select_csv(connection: duckdb.DuckDBPyConnection, source: str) -> str:
    """Return the statement for the rows of `source` with times as text."""
    names, types = describe(connection, source)
    columns = [f"c{number}" for number in range(len(names))]
    cells = (
        f"{time_as_text(column, kind)} AS {identifier(name)}"
        for column, kind, name in zip(columns, types, names, strict=True)
    )
    return f"SELECT {', '.join(cells)} FROM {source} AS t({', '.join(columns)})"


def describe(connection: duckdb.DuckDBPyConnection, source: str) -> tuple[list[str], list[str]]:
    """Return the names and SQL types of the columns of `source`; query() makes names unique."""
    columns = connection.execute(f"SELECT * FROM {source} LIMIT 0").description or []
    return [column[0] for column in columns], [str(column[1]) for column in columns]


def iter_rows(connection: duckdb.DuckDBPyConnection) -> Iterator[Row]:
    """Yield the rows of the last statement, fetched in batches."""
    return chain.from_iterable(iter(lambda: connection.fetchmany(_BATCH_ROWS), []))


def time_as_text(column: str, kind: str) -> str:
    """Return the SQL of a value as text or JSON: times, which are in UTC, as ISO 8601 with a Z."""
    if kind == "TIMESTAMP WITH TIME ZONE":
        column = f"timezone('UTC', {column})"
    if kind.startswith("TIMESTAMP"):
        return f"replace(CAST({column} AS VARCHAR), ' ', 'T') || 'Z'"
    return column


def write_plan(plans: list[tuple[str, str]], job: dict[str, Any]) -> None:
    """Write the output of EXPLAIN."""
    names = ["explain_key", "explain_value"]
    if job["format"] == "json":
        objects = [json.dumps(dict(zip(names, plan, strict=True)), ensure_ascii=False) for plan in plans]
        write_json(iter(objects), sys.stdout)
    elif job["format"] == "csv":
        csv.writer(sys.stdout, lineterminator="\n").writerows([names, *plans])
    elif job["format"] == "arrow":
        import pyarrow as pa  # noqa: PLC0415 - the other formats do without

        table = pa.table(dict(zip(names, zip(*plans, strict=True), strict=True)))
        with pa.ipc.new_stream(sys.stdout.buffer, table.schema) as writer:
            writer.write_table(table)
    else:
        write_table(QueryRows(names, ["VARCHAR", "VARCHAR"], iter(plans)), sys.stdout)


def quote(text: str) -> str:
    """Return an SQL string literal."""
    return "'" + text.replace("'", "''") + "'"


def identifier(name: str) -> str:
    """Return an SQL identifier."""
    return '"' + name.replace('"', '""') + '"'


def one_line(error: Exception) -> str:
    """Return a message of DuckDB without its copy of the statement."""
    message = " ".join(str(error).partition("\n\nLINE ")[0].split())
    if "Table with name" in message:
        message += "; SHOW TABLES lists the tables and views"
    return message


def fail(kind: str, message: str) -> NoReturn:
    """Report an error to the parent and exit."""
    sys.stderr.write(json.dumps({"kind": kind, "message": message}))
    sys.stderr.flush()
    os._exit(1)


if __name__ == "__main__":
    main()
