"""`lsnet-pipe query`."""

from __future__ import annotations

import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from inspect_pipeline.commands.options import StoreOption, finite, open_store

_MAX_SQL_CHARS = 1 << 20


class OutputFormat(StrEnum):
    """Values of `--format`."""

    table = "table"
    csv = "csv"
    json = "json"
    parquet = "parquet"


_SUFFIXES = {
    ".txt": OutputFormat.table,
    ".csv": OutputFormat.csv,
    ".json": OutputFormat.json,
    ".parquet": OutputFormat.parquet,
}


def query(
    sql: Annotated[
        str | None, typer.Argument(metavar="SQL", help="One reading statement, in quotes; - reads stdin.")
    ] = None,
    file: Annotated[
        Path | None, typer.Option("--file", "-f", metavar="FILE", help="Read the statement from this file.")
    ] = None,
    named: Annotated[
        str | None, typer.Option(metavar="NAME", help="Run a named query; `list` shows them.")
    ] = None,
    param: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=VALUE", help="A value of the named query; may be repeated."),
    ] = None,
    show_sql: Annotated[
        bool, typer.Option("--show-sql", help="Print the SQL of the named query, and stop.")
    ] = False,
    store: StoreOption = None,
    output_format: Annotated[
        OutputFormat | None,
        typer.Option("--format", help="Format of the rows. Default: from the suffix of -o, else table."),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FILE", help="Write all rows to this file instead of stdout."),
    ] = None,
    allow_files: Annotated[
        bool, typer.Option("--allow-files", help="Let the statement read files, as in read_csv.")
    ] = False,
    timeout: Annotated[
        float,
        typer.Option(
            min=0.1, max=1e6, callback=finite, metavar="SECONDS", help="Stop a query that runs longer."
        ),
    ] = 60.0,
) -> None:
    """Query the index in SQL.

    One SELECT, WITH, EXPLAIN, DESCRIBE, SHOW or SUMMARIZE statement is run, or a named query.

    \b
    Examples:
      lsnet-pipe query "SELECT source_uri, n_frames, n_lines FROM flight_summary"
      lsnet-pipe query "FROM frames" -o frames.csv
      lsnet-pipe query -f gaps.sql --format json
      lsnet-pipe query --named list
    """
    if [sql, file, named].count(None) < 2:
        raise typer.BadParameter("give one of SQL, --file and --named")
    if named is None and (param or show_sql):
        raise typer.BadParameter("--param and --show-sql go with --named NAME")
    chosen = _choose_format(output_format, output)
    statement = _find_named(named, param or [], show_sql) if named else _read_sql(sql, file)
    if statement is None:
        return

    from inspect_pipeline.index.query import QueryLimits, run_query

    run_query(
        open_store(store).index_path,
        statement,
        format=chosen.value,
        output=output,
        limits=QueryLimits(timeout_s=timeout),
        allow_files=allow_files,
    )


def _choose_format(given: OutputFormat | None, output: Path | None) -> OutputFormat:
    """Return the format that is asked for; that of a file has to agree with its suffix."""
    by_suffix = _SUFFIXES.get(output.suffix.lower()) if output else None
    if given and by_suffix and given is not by_suffix:
        raise typer.BadParameter(f"{output} does not end as a file of --format {given.value}")
    if output and output.suffix and not (given or by_suffix):
        raise typer.BadParameter(f"{output} ends in none of {', '.join(_SUFFIXES)}; give --format")
    return given or by_suffix or OutputFormat.table


def _read_sql(sql: str | None, file: Path | None) -> str:
    if file and str(file) != "-":
        try:
            with file.open(encoding="utf-8") as opened:
                text = opened.read(_MAX_SQL_CHARS + 1)
        except (OSError, ValueError) as error:
            why = getattr(error, "strerror", None) or error
            raise typer.BadParameter(f"{file}: cannot be read as text ({why})") from error
    elif sql is None or sql == "-":
        if sql is None and file is None and (sys.stdin is None or sys.stdin.isatty()):
            raise typer.BadParameter("give SQL, --file FILE or --named NAME; --named list shows the names")
        try:
            text = sys.stdin.read(_MAX_SQL_CHARS + 1)
        except ValueError as error:
            raise typer.BadParameter(f"stdin is not text ({error})") from error
    else:
        text = sql
        _refuse_name(sql)
    if not text.strip():
        raise typer.BadParameter("the statement is empty; give SQL, --file FILE or --named NAME")
    if len(text) > _MAX_SQL_CHARS:
        raise typer.BadParameter("the statement is longer than 1 MiB")
    return text


def _refuse_name(sql: str) -> None:
    from inspect_pipeline.index.named_queries import named_queries

    if sql.isidentifier() and sql in named_queries():
        raise typer.BadParameter(f"{sql!r} is no statement; --named {sql} runs the named query")


def _find_named(name: str, values: list[str], is_shown: bool) -> str | None:
    """Return the SQL of a named query, or None if names or SQL were asked for, and printed."""
    from inspect_pipeline.index.named_queries import find_query, named_queries

    if name == "list":
        for query in named_queries().values():
            needed = "".join(f" --param {parameter}=..." for parameter in query.parameters)
            typer.echo(f"{query.name}{needed}\n    {query.purpose}")
        return None
    query = find_query(name)
    if is_shown:
        typer.echo(query.sql.rstrip())
        return None
    pairs = [value.partition("=") for value in values]
    if wrong := [key for key, equals, _ in pairs if not equals]:
        raise typer.BadParameter(f"{wrong[0]!r} is not of the form NAME=VALUE")
    return query.with_values({key: value for key, _, value in pairs})
