"""`lsnet-pipe flights list`, `show`, `rm` and `tag`."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Annotated, Any

import typer

from inspect_pipeline.commands.options import FlightArgument, JsonOption, StoreOption, open_store
from inspect_pipeline.commands.output import print_line, print_table
from inspect_pipeline.commands.times import TimezoneOption, format_time

if TYPE_CHECKING:
    from collections.abc import Mapping

app = typer.Typer(
    help="List, show, tag and remove flights.",
    epilog="Example: lsnet-pipe flights list",
    no_args_is_help=True,
)


@app.command("list")
def list_flights(
    store: StoreOption = None, as_json: JsonOption = False, timezone: TimezoneOption = None
) -> None:
    """List all flights.

    \b
    Examples:
      lsnet-pipe flights list
      lsnet-pipe flights list --timezone Europe/Zurich
      lsnet-pipe flights list --json
    """
    from inspect_pipeline.index.flights import describe_flights
    from inspect_pipeline.store.images import source_path

    flights = describe_flights(open_store(store), [])
    if as_json:
        for flight in flights:
            typer.echo(json.dumps(flight))
        return
    rows = [
        (
            flight["flight_id"][:16],
            format_time(flight["start_utc"], timezone),
            flight["n_frames"],
            flight["n_bad_frames"],
            flight["n_lines"],
            flight["n_open_anomalies"],
            source_path(flight["source_uri"]).name,
            _join_tags(flight["tags"]),
        )
        for flight in flights
    ]
    headers = ("flight_id", "start", "frames", "bad", "lines", "open_anomalies", "recording", "tags")
    print_table(headers, rows, "no flights; lsnet-pipe process adds some")


@app.command()
def show(flight: FlightArgument, store: StoreOption = None, as_json: JsonOption = False) -> None:
    """Show what is known of a flight.

    \b
    Examples:
      lsnet-pipe flights show 42c8f628
    """
    from inspect_pipeline.index.check import rules_not_judged
    from inspect_pipeline.index.flights import describe_flights, find_flight
    from inspect_pipeline.store.images import source_path

    source = open_store(store)
    flight_id = find_flight(source, flight)
    (found,) = describe_flights(source, [flight_id])
    found["not_judged"] = rules_not_judged(source, [flight_id]).get(flight_id, [])
    if as_json:
        typer.echo(json.dumps(found))
        return
    for name, value in found.items():
        text = str(source_path(value)) if name == "source_uri" else _to_text(value)
        print_line(f"{name:24} {text}")


@app.command()
def rm(flight: FlightArgument, store: StoreOption = None) -> None:
    """Remove a flight from the store.

    Its recording stays where it is: a batch that finds it processes it again.

    \b
    Examples:
      lsnet-pipe flights rm 42c8f628261a909a
    """
    from inspect_pipeline.index.flights import find_flight
    from inspect_pipeline.publishing import publish

    target = open_store(store)
    flight_id = find_flight(target, flight)
    target.remove_flight(flight_id)
    publish(target)
    print_line(f"{flight_id} removed")


@app.command()
def tag(
    flight: FlightArgument,
    tags: Annotated[list[str], typer.Argument(metavar="KEY=VALUE", help="KEY= removes a tag.")],
    store: StoreOption = None,
) -> None:
    """Set tags of a flight, which are in the table flight_tags.

    \b
    Examples:
      lsnet-pipe flights tag 42c8f628 line=L12 pilot=kim
      lsnet-pipe flights tag 42c8f628 pilot=
    """
    from inspect_pipeline.index.flights import find_flight
    from inspect_pipeline.publishing import publish
    from inspect_pipeline.store.feedback import add_tag

    pairs = [one.partition("=") for one in tags]
    if wrong := [key + value for key, equals, value in pairs if not (key and equals)]:
        raise typer.BadParameter(f"{wrong[0]!r} is not of the form KEY=VALUE")
    target = open_store(store)
    flight_id = find_flight(target, flight)
    for key, _, value in pairs:
        add_tag(target, flight_id, key, value or None)
    publish(target)
    print_line(f"{flight_id} {' '.join(tags)}")


def _join_tags(tags: Mapping[str, str]) -> str:
    return " ".join(f"{key}={value}" for key, value in tags.items())


def _to_text(value: Any) -> str:
    if value is None or value == []:
        return "-"
    if isinstance(value, list):
        return "; ".join(value)
    if isinstance(value, float):
        return f"{value:,.3f}".rstrip("0").rstrip(".")
    return _join_tags(value) or "-" if isinstance(value, dict) else str(value)
