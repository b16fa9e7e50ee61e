"""`lsnet-pipe check`."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from inspect_pipeline.commands.batch_log import printable
from inspect_pipeline.commands.flights import FlightOption
from inspect_pipeline.commands.options import JsonOption, StoreOption

_FAILED = 4


def check(
    flight: FlightOption = None,
    rules: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Thresholds in TOML; else those of the store.")
    ] = None,
    store: StoreOption = None,
    as_json: JsonOption = False,
) -> None:
    """Fail, with exit code 4, for flights with open anomalies that count or with too little seen.

    Example: lsnet-pipe check --rules strict.toml
    """
    from inspect_pipeline.index import publish as index
    from inspect_pipeline.index.check import check_flights
    from inspect_pipeline.index.flights import find_flights
    from inspect_pipeline.store.store import Store, store_path

    source = Store(store_path(store))
    every = "SELECT flight_id FROM flights ORDER BY start_ns, flight_id"
    flights = (
        find_flights(source, flight) if flight else [row["flight_id"] for row in index.select(source, every)]
    )
    failures = check_flights(source, flights, rules)
    for failure in failures:
        if as_json:
            typer.echo(json.dumps(asdict(failure)))
        else:
            what = f"{failure.rule}: {failure.detail}"
            told = f"  ({failure.anomaly_id})" if failure.anomaly_id else ""
            typer.echo(f"{failure.flight_id[:16]}  {printable(what)}{told}")
    if failures:
        raise typer.Exit(_FAILED)
    if not as_json:
        typer.echo(f"{len(flights)} flights pass")
