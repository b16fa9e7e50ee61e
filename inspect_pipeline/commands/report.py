"""`lsnet-pipe report`."""

from __future__ import annotations

import webbrowser
from pathlib import Path
from typing import Annotated

import typer

from inspect_pipeline.commands.options import StoreOption, check_suffix, open_store
from inspect_pipeline.commands.output import print_line


def report(
    flight: Annotated[
        str | None,
        typer.Argument(
            metavar="FLIGHT", help="A flight_id or its start, the name of its recording, or last."
        ),
    ] = None,
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
    """
    if flight is None:
        raise typer.BadParameter("give a FLIGHT, such as last")
    check_suffix(output, (".html", ".htm"))

    from inspect_pipeline.report.data import resolve_flight
    from inspect_pipeline.report.page import render_flight, write_page

    source = open_store(store)
    flight_id = resolve_flight(source, flight)
    write_page(output, render_flight(source, flight_id))
    print_line(f"{output}: flight {flight_id[:16]}")
    if open_page:
        webbrowser.open(output.absolute().as_uri())
