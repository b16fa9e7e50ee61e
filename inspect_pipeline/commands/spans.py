"""`lsnet-pipe spans import` and `list`."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from inspect_pipeline.commands.options import JsonOption, StoreOption, open_store
from inspect_pipeline.commands.output import print_line, print_table
from inspect_pipeline.errors import count_of

_NEAR_FLIGHTS = """
SELECT (SELECT count(DISTINCT span_id) FROM coverage WHERE span_id IN (SELECT unnest(?))) AS n_spans,
       (SELECT count(*) FROM coverage WHERE kind = 'corridor' AND total > 0) AS n_placed_flights
"""

app = typer.Typer(
    help="Import and list the spans that coverage is about.",
    epilog="Example: lsnet-pipe spans import towers.csv",
    no_args_is_help=True,
)


@app.command("import")
def import_file(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="CSV of structures or assets, or GeoJSON.")],
    conductors: Annotated[
        int | None,
        typer.Option(min=1, metavar="N", help="Expected conductors side by side, where the file has none."),
    ] = None,
    store: StoreOption = None,
) -> None:
    """Import spans, in place of those of the same lines.

    The coverage of all flights is computed again.

    \b
    Examples:
      lsnet-pipe spans import towers.csv --conductors 4
    """
    from inspect_pipeline.index.reading import select
    from inspect_pipeline.inspection.span_files import read_spans
    from inspect_pipeline.inspection.spans import describe_extent, import_spans
    from inspect_pipeline.publishing import publish

    target = open_store(store, create=True)
    spans = read_spans(file, conductors)
    total = import_spans(target, spans)
    publish(target)
    print_line(f"{count_of(len(spans), 'span')} imported; the store has {total:,}")
    print_line(describe_extent(spans))
    near = select(target, _NEAR_FLIGHTS, [[span.span_id for span in spans]])[0]
    if near["n_placed_flights"]:
        print_line(f"{near['n_spans']} of {len(spans)} within near_m of a flight")
    if near["n_placed_flights"] and not near["n_spans"]:
        message = "no flight is near these spans: are latitude and longitude swapped, or is it another line?"
        typer.echo(message, err=True)


@app.command("list")
def list_spans(store: StoreOption = None, as_json: JsonOption = False) -> None:
    """List the spans of the store.

    \b
    Examples:
      lsnet-pipe spans list
      lsnet-pipe spans list --json
    """
    from inspect_pipeline.inspection.spans import load_spans

    spans = load_spans(open_store(store))
    if as_json:
        for span in spans:
            typer.echo(json.dumps(asdict(span)))
        return
    rows = [(span.line_id, span.span_id, round(span.length_m, 1), span.expected_conductors) for span in spans]
    print_table(
        ("line_id", "span_id", "length_m", "conductors"), rows, "no spans; lsnet-pipe spans import adds some"
    )
