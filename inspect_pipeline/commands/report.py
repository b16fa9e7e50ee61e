"""`lsnet-pipe report`."""

from __future__ import annotations

import webbrowser
from pathlib import Path
from typing import Annotated

import typer

from inspect_pipeline.commands.options import OptionalFlightArgument, StoreOption, check_suffix, open_store
from inspect_pipeline.commands.output import print_line


def report(
    flight: OptionalFlightArgument = None,
    all_flights: Annotated[
        bool, typer.Option("--all", help="One page of all flights and spans of the store.")
    ] = False,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FILE", help="The page to write.")] = Path(
        "report.html"
    ),
    open_page: Annotated[bool, typer.Option("--open", help="Open the page in the browser.")] = False,
    store: StoreOption = None,
) -> None:
    """Write the report of a flight as one page.

    \b
    Examples:
      lsnet-pipe report last --open
      lsnet-pipe report flight.mcap -o flight.html
      lsnet-pipe report --all -o store.html
    """
    if (flight is None) != all_flights:
        raise typer.BadParameter("give a FLIGHT, such as last, or --all")
    check_suffix(output, (".html", ".htm"))
    source = open_store(store)

    from inspect_pipeline.report.page import write_page

    if flight is None:
        from inspect_pipeline.report.store_page import render_store

        write_page(output, render_store(source, {}))
        print_line(f"{output}: all flights")
    else:
        from inspect_pipeline.index.flights import find_flight
        from inspect_pipeline.report.flight_page import render_flight

        flight_id = find_flight(source, flight)
        write_page(output, render_flight(source, flight_id))
        print_line(f"{output}: flight {flight_id[:16]}")
    if open_page:
        webbrowser.open(output.absolute().as_uri())
