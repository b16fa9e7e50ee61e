"""The child process of query.py: limits itself, runs one reading statement, writes the rows to stdout.

Started as a script with a job in JSON on stdin. It imports nothing of this package, to start quickly.
Ends with 0, or with 1 and one JSON object on stderr: {"kind": "query" | "store" | "version", "message": ...}.
"""

from __future__ import annotations

import csv
import json
import os
import re
import resource
import sys
from itertools import chain, islice
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn, TextIO

if TYPE_CHECKING:
    from collections.abc import Iterator

    import duckdb

_BATCH_ROWS = 2048
_MAX_CELL = 80
_OVERHEAD_BYTES = 3 << 29  # address space of Python, DuckDB and their threads
_MAX_PARQUET_BYTES = 64 << 30
_COPY_OPTIONS = {"csv": "FORMAT csv, HEADER", "parquet": "FORMAT parquet, COMPRESSION zstd"}
_EXPLAIN = re.compile(r"\s*EXPLAIN\b(\s+ANALYZE\b)?(.*)", re.IGNORECASE | re.DOTALL)
_NUMBER = re.compile(r"U?(TINY|SMALL|BIG|HUGE)?INT(EGER)?|FLOAT|DOUBLE|DECIMAL.*")
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

Row = tuple[str | None, ...]


class Rows(NamedTuple):
    """The result of a statement: column names, their SQL types, and an iterator of rows of texts."""

    names: list[str]
    types: list[str]
    rows: Iterator[Row]


def main() -> None:
    """Run the job of stdin."""
    job = json.load(sys.stdin)
    limit_process(job)
    import duckdb  # noqa: PLC0415 - after the limits

    try:
        connection = open_index(job)
    except duckdb.Error as error:
        fail("store", one_line(error))
    try:
        check_statement(job["sql"])
        run_statement(connection, job)
        sys.stdout.flush()
        os._exit(0)  # spares the time to take interpreter and database down
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
        resource.setrlimit(what, (limit, limit))


def open_index(job: dict[str, Any]) -> duckdb.DuckDBPyConnection:
    """Open the index read-only, then shut the file system and the settings; raises duckdb.Error."""
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
        connection.execute(f"COPY (FROM {source}) TO {target}")
    elif job["format"] == "json":
        write_json(select_objects(connection, source), sys.stdout)
    else:
        write_table(select_texts(connection, source), job["max_rows"], sys.stdout)


def select_texts(connection: duckdb.DuckDBPyConnection, source: str) -> Rows:
    """The rows of `source`, every cell turned into text by DuckDB itself."""
    names, types = describe(connection, source)
    columns = [f"c{number}" for number in range(len(names))]
    cells = ", ".join(f"CAST({column} AS VARCHAR)" for column in columns)
    connection.execute(f"SELECT {cells} FROM {source} AS t({', '.join(columns)})")
    return Rows(names, types, iter_rows(connection))


def select_objects(connection: duckdb.DuckDBPyConnection, source: str) -> Iterator[str]:
    """The rows of `source` as JSON objects, in which NaN and Infinity may stand."""
    names, types = describe(connection, source)
    columns = [f"c{number}" for number in range(len(names))]
    cells = (json_value(column, kind) for column, kind in zip(columns, types, strict=True))
    pairs = ", ".join(f"{quote(name)}, {cell}" for name, cell in zip(names, cells, strict=True))
    connection.execute(
        f"SELECT CAST(json_object({pairs}) AS VARCHAR) FROM {source} AS t({', '.join(columns)})"
    )
    return (row[0] or "null" for row in iter_rows(connection))


def describe(connection: duckdb.DuckDBPyConnection, source: str) -> tuple[list[str], list[str]]:
    """Names, each once, and SQL types of the columns of `source`."""
    columns = connection.execute(f"SELECT * FROM {source} LIMIT 0").description or []
    return [column[0] for column in columns], [str(column[1]) for column in columns]


def iter_rows(connection: duckdb.DuckDBPyConnection) -> Iterator[Row]:
    """The rows of what was just executed, fetched as they are needed."""
    return chain.from_iterable(iter(lambda: connection.fetchmany(_BATCH_ROWS), []))


def json_value(column: str, kind: str) -> str:
    """The SQL of a value for JSON: times become ISO 8601, with a Z where they have a zone."""
    if kind == "TIMESTAMP WITH TIME ZONE":
        return f"replace(CAST(timezone('UTC', {column}) AS VARCHAR), ' ', 'T') || 'Z'"
    if kind.startswith("TIMESTAMP"):
        return f"replace(CAST({column} AS VARCHAR), ' ', 'T')"
    return column


def write_plan(plans: list[tuple[str, str]], job: dict[str, Any]) -> None:
    """Write what EXPLAIN says."""
    names = ["explain_key", "explain_value"]
    if job["format"] == "json":
        objects = [json.dumps(dict(zip(names, plan, strict=True)), ensure_ascii=False) for plan in plans]
        write_json(iter(objects), sys.stdout)
    elif job["format"] == "csv":
        csv.writer(sys.stdout, lineterminator="\n").writerows([names, *plans])
    else:
        write_table(Rows(names, ["VARCHAR", "VARCHAR"], iter(plans)), job["max_rows"], sys.stdout)


def write_json(objects: Iterator[str], out: TextIO) -> None:
    """Write an array of objects, one a line; NaN and infinities, which JSON lacks, become null."""
    separator = "[\n"
    for text in objects:
        has_nan = "NaN" in text or "Infinity" in text
        out.write(separator + (nan_to_null(text) if has_nan else text))
        separator = ",\n"
    out.write("[]\n" if separator == "[\n" else "\n]\n")


def nan_to_null(text: str) -> str:
    """A JSON text of DuckDB as valid JSON."""
    return json.dumps(json.loads(text, parse_constant=lambda _: None), ensure_ascii=False)


def write_table(rows: Rows, max_rows: int, out: TextIO) -> None:
    """Write at most `max_rows` rows in columns, numbers to the right, and how many there are."""
    shown = [[cell_lines(cell) for cell in row] for row in islice(rows.rows, max_rows)]
    is_cut = next(rows.rows, None) is not None
    names = [cell_lines(name) for name in rows.names]
    widths = [
        max(len(line) for cell in column for line in cell) for column in zip(names, *shown, strict=True)
    ]
    is_number = [_NUMBER.fullmatch(kind) is not None for kind in rows.types]
    for row in (names, [["-" * width] for width in widths], *shown):
        for height in range(max(len(cell) for cell in row)):
            lines = (cell[height] if height < len(cell) else "" for cell in row)
            padded = (
                line.rjust(width) if right else line.ljust(width)
                for line, width, right in zip(lines, widths, is_number, strict=True)
            )
            out.write("  ".join(padded).rstrip() + "\n")
    count = f"the first {max_rows} rows; all with --format csv" if is_cut else f"{len(shown)} rows"
    out.write(f"({count})\n")


def cell_lines(cell: str | None) -> list[str]:
    """The lines of a cell, cut to a readable width; control characters are escaped, NULL is said."""
    if cell is None:
        return ["NULL"]
    lines = cell.rstrip("\n").split("\n") if cell else [""]
    visible = ("".join(c if c.isprintable() else ascii(c)[1:-1] for c in line) for line in lines)
    return [line if len(line) <= _MAX_CELL else line[: _MAX_CELL - 1] + "…" for line in visible]


def quote(text: str) -> str:
    """An SQL string literal."""
    return "'" + text.replace("'", "''") + "'"


def one_line(error: Exception) -> str:
    """A message of DuckDB without its copy of the statement."""
    message = " ".join(str(error).partition("\n\nLINE ")[0].split())
    if "Table with name" in message:
        message += "; SHOW TABLES lists the tables and views"
    return message


def fail(kind: str, message: str) -> NoReturn:
    """Tell the parent what is wrong and end."""
    sys.stderr.write(json.dumps({"kind": kind, "message": message}))
    sys.stderr.flush()
    os._exit(1)


if __name__ == "__main__":
    main()
