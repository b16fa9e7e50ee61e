"""`lsnet-pipe view`."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from inspect_pipeline.commands.options import OptionalFlightArgument, PortOption, StoreOption, open_store
from inspect_pipeline.commands.output import print_line

if TYPE_CHECKING:
    from inspect_pipeline.store.store import Store

_LAYOUTS = "~/.lichtblick-suite/layouts"


def view(
    flight: OptionalFlightArgument = None,
    anomaly: Annotated[
        str | None, typer.Option(metavar="ID", help="Start at this anomaly; no FLIGHT needed.")
    ] = None,
    lichtblick: Annotated[
        str, typer.Option(metavar="URL", help="Address of a Lichtblick in the browser.")
    ] = "http://localhost:8080",
    port: PortOption = 0,
    store: StoreOption = None,
) -> None:
    """Show a flight in Lichtblick or Foxglove.

    Its files are served to this machine, and the links printed. Stop it with Ctrl-C.

    \b
    Examples:
      lsnet-pipe view last
      lsnet-pipe view --anomaly 0a1b2c --lichtblick https://lichtblick.example.org
    """
    if (flight is None) == (anomaly is None):
        raise typer.BadParameter("give a FLIGHT, such as last, or --anomaly ID")
    source = open_store(store)
    flight_id, time_ns = _find(source, flight, anomaly)

    from inspect_pipeline.errors import OutputError
    from inspect_pipeline.export.serve import ADDRESS, FileServer, viewer_files
    from inspect_pipeline.export.viewer_files import LAYOUT
    from inspect_pipeline.publishing import publish

    files = viewer_files(source, flight_id)
    if LAYOUT not in files:  # a store that an older version published
        publish(source)
        files = viewer_files(source, flight_id)
    try:
        server = FileServer(files, port)
    except OSError as error:
        raise OutputError(
            Path(f"{ADDRESS}:{port}"), f"cannot be served ({error.strerror})", "choose another port"
        ) from error
    links = server.links(lichtblick, time_ns)
    print_line(f"Lichtblick  {links.lichtblick}")
    print_line(f"Foxglove    {links.foxglove}")
    print_line(f"            with the layout {links.layout}, by Import from file")
    _print_desktop(files, flight_id[:8])
    typer.echo("serving until Ctrl-C", err=True)
    server.run()


def _find(store: Store, flight: str | None, anomaly: str | None) -> tuple[str, int | None]:
    """Return the flight_id and the time to start at."""
    from inspect_pipeline.index.anomalies import find_anomaly
    from inspect_pipeline.index.flights import find_flight

    if anomaly is not None:
        row = find_anomaly(store, anomaly)
        return row["flight_id"], row["start_ns"]
    return find_flight(store, flight or ""), None


def _print_desktop(files: dict[str, Path], name: str) -> None:
    """Print how the desktop applications open the files: a command, and what to drop into the window."""
    recordings = [str(path) for path in files.values() if path.suffix == ".mcap"]
    layout = str(files["layout.json"])
    print_line(
        f"Desktop     mkdir -p {_LAYOUTS} && cp {shlex.quote(layout)} {_LAYOUTS}/{name}.json &&"
        f" lichtblick {' '.join(map(shlex.quote, recordings))} --defaultLayout={name}"
    )
    print_line(f"            or drop into the window: {' '.join(map(shlex.quote, [*recordings, layout]))}")
