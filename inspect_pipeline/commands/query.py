"""`lsnet-pipe query`."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from inspect_pipeline.commands.options import StoreOption


class OutputFormat(StrEnum):
    """What `--format` takes."""

    table = "table"
    csv = "csv"
    json = "json"
    parquet = "parquet"


def query(
    sql: Annotated[str, typer.Argument(metavar="SQL", help="One reading statement, in quotes.")],
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
    timeout: Annotated[float, typer.Option(help="Stop the query after this many seconds.", min=0.1)] = 60.0,
) -> None:
    """Ask the index in SQL: one SELECT, WITH, EXPLAIN, DESCRIBE, SHOW or SUMMARIZE.

    Example: lsnet-pipe query "SELECT source_uri, n_frames, detection_share FROM flight_summary"
    """
    from inspect_pipeline.query import QueryLimits, run_query
    from inspect_pipeline.store import Store, store_path

    run_query(
        Store(store_path(store)).index_path,
        sql,
        format=output_format.value,
        output=output,
        limits=QueryLimits(timeout_s=timeout),
        allow_files=allow_files,
    )
