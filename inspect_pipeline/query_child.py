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
    if job["format"] == "parquet":
        connection.execute(f"SET allowed_paths = [{quote(job['parquet_path'])}]")
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
    explain = _EXPLAIN.fullmatch(job["sql"])
    if job["format"] == "parquet":
        target = f"{quote(job['parquet_path'])} (FORMAT parquet, COMPRESSION zstd, USE_TMP_FILE false)"
        connection.execute(f"COPY (FROM query({quote(job['sql'])})) TO {target}")
    elif explain:
        statement = f"EXPLAIN{explain[1] or ''} SELECT * FROM query({quote(explain[2])})"
        plans = connection.execute(statement).fetchall()
        to_cell = json.dumps if job["format"] == "json" else str
        cells = iter([tuple(to_cell(value) for value in row) for row in plans])
        write_rows(Rows(["explain_key", "explain_value"], ["VARCHAR", "VARCHAR"], cells), job)
    else:
        write_rows(select(connection, f"query({quote(job['sql'])})", job["format"]), job)


def select(connection: duckdb.DuckDBPyConnection, source: str, form: str) -> Rows:
    """The rows of `source`, every cell turned into text, JSON or plain, by DuckDB itself."""
    described = connection.execute(f"SELECT * FROM {source} LIMIT 0").description or []
    names, types = [column[0] for column in described], [str(column[1]) for column in described]
    columns = [f"c{number}" for number in range(len(names))]
    to_cell = json_cell if form == "json" else (lambda column, _: f"CAST({column} AS VARCHAR)")
    cells = [to_cell(column, kind) for column, kind in zip(columns, types, strict=True)]
    connection.execute(f"SELECT {', '.join(cells)} FROM {source} AS t({', '.join(columns)})")
    batches = iter(lambda: connection.fetchmany(_BATCH_ROWS), [])
    return Rows(names, types, chain.from_iterable(batches))


def json_cell(column: str, kind: str) -> str:
    """The SQL that turns a column into JSON; times are ISO 8601, with a Z where they have a zone."""
    if kind == "TIMESTAMP WITH TIME ZONE":
        return f"to_json(replace(CAST(timezone('UTC', {column}) AS VARCHAR), ' ', 'T') || 'Z')"
    if kind.startswith("TIMESTAMP"):
        return f"to_json(replace(CAST({column} AS VARCHAR), ' ', 'T'))"
    return f"to_json({column})"


def write_rows(rows: Rows, job: dict[str, Any]) -> None:
    """Write rows to stdout as csv, json or a table."""
    if job["format"] == "csv":
        writer = csv.writer(sys.stdout, lineterminator="\n")
        writer.writerow(rows.names)
        writer.writerows(rows.rows)
    elif job["format"] == "json":
        write_json(rows, sys.stdout)
    else:
        write_table(rows, job["max_rows"], sys.stdout)


def write_json(rows: Rows, out: TextIO) -> None:
    """Write an array of objects, one a line; NaN and infinities, which JSON lacks, become null."""
    keys = [json.dumps(name, ensure_ascii=False) for name in rows.names]
    has_nan = ["FLOAT" in kind or "DOUBLE" in kind for kind in rows.types]
    out.write("[")
    separator = "\n"
    for row in rows.rows:
        cells = ("null" if cell is None else cell for cell in row)
        finite = (nan_to_null(c) if nan else c for c, nan in zip(cells, has_nan, strict=True))
        out.write(separator + "{" + ", ".join(map("{}: {}".format, keys, finite)) + "}")
        separator = ",\n"
    out.write("\n]\n")


def nan_to_null(cell: str) -> str:
    """A JSON text of DuckDB, in which NaN and Infinity may stand, as valid JSON."""
    if "NaN" not in cell and "Inf" not in cell:
        return cell
    return json.dumps(json.loads(cell, parse_constant=lambda _: None), ensure_ascii=False)


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
