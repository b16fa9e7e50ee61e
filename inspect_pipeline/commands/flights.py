"""`lsnet-pipe flights list`, `show`, `rm` and `tag`."""

from __future__ import annotations

import json
from typing import Annotated

import typer

from inspect_pipeline.commands.batch_log import printable
from inspect_pipeline.commands.options import JsonOption, StoreOption

app = typer.Typer(
    help="The flights of the store.",
    epilog="Example: lsnet-pipe flights list",
    no_args_is_help=True,
)
FlightOption = Annotated[
    str | None, typer.Option(metavar="FLIGHT", help="Only this one; its flight_id or the beginning of it.")
]
FlightArgument = Annotated[
    str, typer.Argument(metavar="FLIGHT", help="Its flight_id, or the beginning of it.")
]


@app.command("list")
def list_flights(store: StoreOption = None, as_json: JsonOption = False) -> None:
    """Show every flight: when, how much was seen, how many anomalies wait for a review.

    Example: lsnet-pipe flights list --json
    """
    from inspect_pipeline.index.flights import describe_flights
    from inspect_pipeline.store.store import Store, store_path

    for flight in describe_flights(Store(store_path(store)), []):
        if as_json:
            typer.echo(json.dumps(flight))
        else:
            seen = f"{flight['n_frames']} frames  {flight['n_open_anomalies']} open anomalies"
            tags = " ".join(f"{key}={value}" for key, value in flight["tags"].items())
            start = (flight["start_utc"] or "-")[:19]
            name = printable(f"{flight['source_uri'].rpartition('/')[2]}  {tags}")
            typer.echo(f"{flight['flight_id'][:16]}  {start:19}  {seen}  {name}")


@app.command()
def show(flight: FlightArgument, store: StoreOption = None, as_json: JsonOption = False) -> None:
    """Show all that is known of a flight in a row.

    Example: lsnet-pipe flights show 42c8f628
    """
    from inspect_pipeline.index.flights import describe_flights, find_flight
    from inspect_pipeline.store.store import Store, store_path

    source = Store(store_path(store))
    (told,) = describe_flights(source, [find_flight(source, flight)])
    if as_json:
        typer.echo(json.dumps(told))
        return
    for name, value in told.items():
        typer.echo(f"{name:24} {printable(str(value))}")


@app.command()
def rm(flight: FlightArgument, store: StoreOption = None) -> None:
    """Remove a flight from the store. Its recording stays: a batch that finds it processes it again.

    Example: lsnet-pipe flights rm 42c8f628261a909a
    """
    from inspect_pipeline.index import publish as index
    from inspect_pipeline.index.flights import find_flight
    from inspect_pipeline.store.store import Store, store_path

    target = Store(store_path(store))
    flight_id = find_flight(target, flight)
    target.remove_flight(flight_id)
    index.publish(target)
    typer.echo(f"{flight_id} removed")


@app.command()
def tag(
    flight: FlightArgument,
    tags: Annotated[list[str], typer.Argument(metavar="KEY=VALUE...", help="KEY= takes a tag away.")],
    store: StoreOption = None,
) -> None:
    """Give a flight tags, by which it is found in the table flight_tags.

    Example: lsnet-pipe flights tag 42c8f628 line=L12 pilot=kim
    """
    from inspect_pipeline.index import publish as index
    from inspect_pipeline.index.flights import find_flight
    from inspect_pipeline.store.feedback import add_tag
    from inspect_pipeline.store.store import Store, store_path

    target = Store(store_path(store))
    pairs = [one.partition("=") for one in tags]
    if wrong := [key + value for key, equals, value in pairs if not (key and equals)]:
        raise typer.BadParameter(f"{wrong[0]!r} is no KEY=VALUE")
    flight_id = find_flight(target, flight)
    for key, _, value in pairs:
        add_tag(target, flight_id, key, value or None)
    index.publish(target)
    typer.echo(f"{flight_id} {' '.join(tags)}")
