"""`lsnet-pipe check`."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from inspect_pipeline.commands.options import FlightOption, JsonOption, StoreOption, open_store
from inspect_pipeline.commands.output import print_table
from inspect_pipeline.errors import count_of, printable
from inspect_pipeline.inspection.rules import Priority

_FAILED = 4


def check(
    flight: FlightOption = None,
    rules: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Thresholds in TOML. Default: those of the store.")
    ] = None,
    fail_on_priority: Annotated[
        Priority | None,
        typer.Option(
            help="Fail for anomalies of this priority and higher instead of the kinds of the rules."
        ),
    ] = None,
    store: StoreOption = None,
    as_json: JsonOption = False,
) -> None:
    """Exit with 4 if a flight fails a rule.

    A flight fails by anomalies that are not dismissed, or by too little coverage, as the rules say. Rules
    that could not judge a flight are reported on stderr; they fail it where the rules say fail_on_not_judged.

    \b
    Examples:
      lsnet-pipe check
      lsnet-pipe check --flight 42c8f628 --rules strict.toml
      lsnet-pipe check --fail-on-priority medium
    """
    from inspect_pipeline.index.check import check_flights
    from inspect_pipeline.index.flights import find_flights

    source = open_store(store)
    flights = find_flights(source, flight)
    results = check_flights(source, flights, rules, fail_on_priority)
    failures = [each for each in results if each.outcome == "failed"]
    for each in results:
        if each.outcome == "not judged":
            typer.echo(printable(f"{each.flight_id[:16]}: {each.rule}: {each.detail}"), err=True)
    if as_json:
        for failure in failures:
            typer.echo(json.dumps(asdict(failure)))
    else:
        rows = [(each.flight_id[:16], each.rule, each.anomaly_id, each.detail) for each in failures]
        passing = "1 flight passes" if len(flights) == 1 else f"{count_of(len(flights), 'flight')} pass"
        print_table(("flight_id", "rule", "anomaly_id", "detail"), rows, passing)
    if failures:
        raise typer.Exit(_FAILED)
