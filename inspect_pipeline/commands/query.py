"""`lsnet-pipe query`."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from inspect_pipeline.commands.options import StoreOption, finite


class OutputFormat(StrEnum):
    """What `--format` takes."""

    table = "table"
    csv = "csv"
    json = "json"
    parquet = "parquet"


def query(
    sql: Annotated[
        str | None, typer.Argument(metavar="SQL", help="One reading statement, in quotes.")
    ] = None,
    named: Annotated[
        str | None, typer.Option(metavar="NAME", help="A query that has a name; `list` shows them.")
    ] = None,
    param: Annotated[
        list[str] | None, typer.Option(metavar="NAME=VALUE", help="A value of the named query.")
    ] = None,
    show_sql: Annotated[bool, typer.Option("--show-sql", help="Print the named query, ask nothing.")] = False,
    store: StoreOption = None,
    output_format: Annotated[
        OutputFormat, typer.Option("--format", help="How to write the rows.")
    ] = OutputFormat.table,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Write to this file instead of stdout.")
    ] = None,
    allow_files: Annotated[
        bool, typer.Option("--allow-files", help="Let the statement read files, as in read_csv.")
    ] = False,
    timeout: Annotated[
        float,
        typer.Option(min=0.1, max=1e6, callback=finite, help="Stop the query after this many seconds."),
    ] = 60.0,
) -> None:
    """Ask the index in SQL: one SELECT, WITH, EXPLAIN, DESCRIBE, SHOW or SUMMARIZE; or a query by its name.

    Example: lsnet-pipe query "SELECT source_uri, n_frames, detection_share FROM flight_summary"
    """
    if (sql is None) == (named is None):
        raise typer.BadParameter("give SQL or --named NAME; --named list shows the names")
    if sql is not None and (param or show_sql):
        raise typer.BadParameter("--param and --show-sql go with --named NAME")
    if sql is None:
        sql = _find_named(named or "", param or [], show_sql)
        if sql is None:
            return
    from inspect_pipeline.index.query import QueryLimits, run_query
    from inspect_pipeline.store.store import Store, store_path

    run_query(
        Store(store_path(store)).index_path,
        sql,
        format=output_format.value,
        output=output,
        limits=QueryLimits(timeout_s=timeout),
        allow_files=allow_files,
    )


def _find_named(name: str, values: list[str], is_shown: bool) -> str | None:
    """The SQL of a named query; None when names or SQL were asked for, and printed."""
    from inspect_pipeline.index.named_queries import find_query, named_queries

    if name == "list":
        for query in named_queries().values():
            needs = "".join(f" --param {parameter}=..." for parameter in query.parameters)
            typer.echo(f"{query.name}{needs}\n    {query.purpose}")
        return None
    query = find_query(name)
    if is_shown:
        typer.echo(query.sql.rstrip())
        return None
    pairs = [value.partition("=") for value in values]
    if wrong := [key for key, equals, _ in pairs if not equals]:
        raise typer.BadParameter(f"{wrong[0]!r} is no NAME=VALUE")
    return query.with_values({key: value for key, _, value in pairs})
