"""`lsnet-pipe anomalies list` and `mark`."""

from __future__ import annotations

import json
from enum import StrEnum
from typing import Annotated

import typer

from inspect_pipeline.commands.batch_log import printable
from inspect_pipeline.commands.flights import FlightOption
from inspect_pipeline.commands.options import JsonOption, StoreOption

app = typer.Typer(
    help="What is odd in flights: candidates with evidence, to be confirmed or dismissed by people.",
    epilog="Example: lsnet-pipe anomalies list",
    no_args_is_help=True,
)

_LIST = """
SELECT * EXCLUDE (start_utc, end_utc, reviewed_at), start_utc::VARCHAR AS start_utc,
       reviewed_at::VARCHAR AS reviewed_at
FROM reviewed_anomalies
WHERE (len(?) = 0 OR flight_id IN (SELECT unnest(?)))
ORDER BY start_ns, anomaly_id
"""


class Verdict(StrEnum):
    """What a person can say of an anomaly."""

    confirmed = "confirmed"
    dismissed = "dismissed"


@app.command("list")
def list_anomalies(
    flight: FlightOption = None,
    show_all: Annotated[bool, typer.Option("--all", help="Also those that were reviewed.")] = False,
    store: StoreOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show the anomalies that nobody has reviewed, with --all every one.

    Example: lsnet-pipe anomalies list --all --json
    """
    from inspect_pipeline.index import publish as index
    from inspect_pipeline.index.flights import find_flights
    from inspect_pipeline.store.store import Store, store_path

    source = Store(store_path(store))
    chosen = find_flights(source, flight) if flight else []
    for row in index.select(source, _LIST, [chosen, chosen]):
        if row["verdict"] != "open" and not show_all:
            continue
        if as_json:
            typer.echo(json.dumps(row))
        else:
            verdict = "" if row["verdict"] == "open" else f"  [{row['verdict']}: {row['note']}]"
            when = f"{row['start_utc'][:19]}  frames {row['first_frame_idx']}-{row['last_frame_idx']}"
            told = f"{row['flight_id'][:16]}  {when}  {row['reason']}{verdict}"
            typer.echo(f"{row['anomaly_id']}  {row['kind']:22}  {printable(told)}")


@app.command()
def mark(
    anomaly_id: Annotated[str, typer.Argument(metavar="ID", help="As told by `anomalies list`.")],
    verdict: Annotated[Verdict, typer.Argument(help="What you make of it.")],
    note: Annotated[str, typer.Option(help="Why; kept with the review.")] = "",
    store: StoreOption = None,
) -> None:
    """Say what an anomaly is; kept in the store, and found again when the flight is processed again.

    Example: lsnet-pipe anomalies mark 0a1b2c3d4e5f dismissed --note "a bird"
    """
    from inspect_pipeline.index import publish as index
    from inspect_pipeline.store.feedback import add_review
    from inspect_pipeline.store.store import Store, store_path

    target = Store(store_path(store))
    rows = index.select(target, "SELECT * FROM anomalies WHERE anomaly_id = ?", [anomaly_id])
    if not rows:
        raise typer.BadParameter(f"{anomaly_id!r} is no anomaly; see lsnet-pipe anomalies list --all")
    add_review(target, rows[0], verdict.value, note)
    index.publish(target)
    typer.echo(f"{anomaly_id} {verdict.value}")
