"""`lsnet-pipe review`."""

from __future__ import annotations

import webbrowser
from pathlib import Path
from typing import Annotated

import typer

from inspect_pipeline.commands.options import PortOption, StoreOption, open_store
from inspect_pipeline.commands.output import print_line


def review(
    flight: Annotated[
        str | None,
        typer.Argument(
            metavar="FLIGHT",
            help="A flight_id or its first characters, the name of its recording, or last. Default: all.",
        ),
    ] = None,
    port: PortOption = 0,
    open_page: Annotated[bool, typer.Option("--open", help="Open the page in the browser.")] = False,
    store: StoreOption = None,
) -> None:
    """Decide about anomalies in the browser.

    Wrong and missed lines can be corrected, too. The report is served to this machine alone, at the address
    that is printed. Keys: j and k move, c confirms, d dismisses. Stop it with Ctrl-C.

    \b
    Examples:
      lsnet-pipe review last --open
      lsnet-pipe review 3f2a --port 8000
    """
    source = open_store(store)

    from inspect_pipeline.errors import OutputError
    from inspect_pipeline.index.flights import find_flight
    from inspect_pipeline.review.decisions import Publisher
    from inspect_pipeline.review.server import ADDRESS, ReviewServer

    flight_id = None if flight is None else find_flight(source, flight)
    with Publisher(source) as publisher:
        publisher.request()  # what an older version or a killed publish left undone
        try:
            server = ReviewServer(source, flight_id, publisher, port)
        except OSError as error:
            problem = f"cannot be listened on ({error.strerror})"
            raise OutputError(Path(f"{ADDRESS}:{port}"), problem, "choose another port") from error
        with server:
            print_line(server.url)
            if open_page:
                webbrowser.open(server.url)
            server.serve_forever()
