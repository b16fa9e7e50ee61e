"""`lsnet-pipe compare`."""

from __future__ import annotations

import json
from typing import Annotated

import typer

from inspect_pipeline.commands.options import JsonOption, StoreOption, open_store
from inspect_pipeline.commands.output import print_table
from inspect_pipeline.errors import count_of

_HEADERS = ("span_id", "conductor", "subject", "before", "after", "sd")


def compare(
    before: Annotated[
        str,
        typer.Argument(
            metavar="FLIGHT",
            help="The earlier flight: a flight_id or its first characters, or the name of its recording.",
        ),
    ],
    after: Annotated[str, typer.Argument(metavar="FLIGHT", help="The later flight.")],
    store: StoreOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show what changed on spans from one flight to another.

    Compares the number of conductors, the sag of each, and the anomalies of each kind, only where both
    flights judged them. How many spans that were is reported on stderr.

    \b
    Examples:
      lsnet-pipe compare 42c8f628 9a1b77e0
    """
    from inspect_pipeline.index.compare import compare_flights
    from inspect_pipeline.index.flights import find_flight

    source = open_store(store)
    found = compare_flights(source, find_flight(source, before), find_flight(source, after))
    typer.echo(f"{count_of(found.n_spans, 'span')} judged by both flights", err=True)
    if as_json:
        for change in found.changes:
            typer.echo(json.dumps(change))
        return
    rows = [[change[name] for name in _HEADERS] for change in found.changes]
    print_table(_HEADERS, rows, "no change")
