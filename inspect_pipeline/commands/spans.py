"""`lsnet-pipe spans import` and `list`."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from inspect_pipeline.commands.batch_log import printable
from inspect_pipeline.commands.options import JsonOption, StoreOption

app = typer.Typer(
    help="The spans of the grid, against which coverage is measured.",
    epilog="Example: lsnet-pipe spans import towers.csv",
    no_args_is_help=True,
)


@app.command("import")
def import_file(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="CSV of structures or assets, or GeoJSON.")],
    conductors: Annotated[
        int | None,
        typer.Option(min=1, metavar="N", help="Expected side by side, where the file does not say."),
    ] = None,
    store: StoreOption = None,
) -> None:
    """Keep the spans of a file in the store, in place of those of the same lines.

    Example: lsnet-pipe spans import towers.csv --conductors 4
    """
    from inspect_pipeline.index import publish as index
    from inspect_pipeline.inspection.spans import import_spans, read_spans
    from inspect_pipeline.store.store import Store, store_path

    target = Store(store_path(store))
    spans = read_spans(file, conductors)
    total = import_spans(target, spans)
    index.publish(target)
    typer.echo(f"{len(spans)} spans imported; the store has {total}")


@app.command("list")
def list_spans(store: StoreOption = None, as_json: JsonOption = False) -> None:
    """Show the spans of the store.

    Example: lsnet-pipe spans list --json
    """
    from inspect_pipeline.inspection.spans import load_spans
    from inspect_pipeline.store.store import Store, store_path

    for span in load_spans(Store(store_path(store))):
        if as_json:
            typer.echo(json.dumps(asdict(span)))
        else:
            expected = "" if span.expected_conductors is None else f"  {span.expected_conductors} conductors"
            name = printable(f"{span.line_id or '-'}  {span.span_id}")
            typer.echo(f"{name}  {span.length_m:.1f} m{expected}")
