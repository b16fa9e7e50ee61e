"""`lsnet-pipe anomalies list` and `mark`."""

from __future__ import annotations

import json
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Any

import typer

from inspect_pipeline.commands.options import FlightOption, JsonOption, StoreOption, open_store
from inspect_pipeline.commands.output import print_line, print_table
from inspect_pipeline.commands.times import TimezoneOption, format_time
from inspect_pipeline.inspection.rules import PRIORITIES, Priority

if TYPE_CHECKING:
    from datetime import tzinfo

app = typer.Typer(
    help="List and review anomalies: candidates with evidence.",
    epilog="Example: lsnet-pipe anomalies list",
    no_args_is_help=True,
)


class Decision(StrEnum):
    """The decision of a person about an anomaly; `open` takes an earlier one back."""

    confirmed = "confirmed"
    dismissed = "dismissed"
    open = "open"


@app.command("list")
def list_anomalies(
    flight: FlightOption = None,
    priority: Annotated[
        Priority | None, typer.Option(help="Only anomalies of this priority and higher.")
    ] = None,
    show_all: Annotated[bool, typer.Option("--all", help="Include reviewed anomalies.")] = False,
    store: StoreOption = None,
    as_json: JsonOption = False,
    timezone: TimezoneOption = None,
) -> None:
    """List anomalies that are not reviewed yet.

    \b
    Examples:
      lsnet-pipe anomalies list --priority high
      lsnet-pipe anomalies list --flight 42c8f628 --all --json
    """
    from inspect_pipeline.index.anomalies import list_anomalies as select_anomalies
    from inspect_pipeline.index.flights import find_flights

    source = open_store(store)
    rows = select_anomalies(source, [] if flight is None else find_flights(source, flight))
    priorities = PRIORITIES[: PRIORITIES.index(priority) + 1] if priority else PRIORITIES
    shown = [row for row in rows if row["priority"] in priorities and (show_all or row["verdict"] == "open")]
    if as_json:
        for row in shown:
            typer.echo(json.dumps(row))
        return
    headers = ("anomaly_id", "priority", "kind", "flight_id", "start", "frames", "look_at", "place")
    empty = "no anomalies" if show_all or not rows else "no open anomalies; --all lists the reviewed ones"
    print_table((*headers, "reason", "review"), [_to_row(row, timezone) for row in shown], empty)


@app.command()
def mark(
    anomaly_id: Annotated[str, typer.Argument(metavar="ID", help="An anomaly_id or the start of it.")],
    decision: Annotated[Decision, typer.Argument(help="Your decision; open takes an earlier one back.")],
    note: Annotated[str, typer.Option(metavar="TEXT", help="Why; kept with the review.")] = "",
    by: Annotated[
        str | None, typer.Option(metavar="NAME", help="Who decides. Default: the user of this process.")
    ] = None,
    store: StoreOption = None,
) -> None:
    """Confirm or dismiss an anomaly.

    Reviews are kept when the flight is processed again.

    \b
    Examples:
      lsnet-pipe anomalies mark 0a1b2c dismissed --note "a bird"
      lsnet-pipe anomalies mark 0a1b2c open --by kim
    """
    from inspect_pipeline.publishing import publish
    from inspect_pipeline.review.decisions import decide

    target = open_store(store)
    review = decide(target, anomaly_id, decision.value, note, by)
    publish(target)
    print_line(f"{review.anomaly_id} {review.verdict}")


def _to_row(row: dict[str, Any], timezone: tzinfo | None) -> tuple[str | None, ...]:
    where = [] if row["lat_deg"] is None else [f"{row['lat_deg']:.6f},{row['lon_deg']:.6f}"]
    if row["span_id"]:
        where.append(f"span {row['span_id']}")
    review = None
    if row["verdict"] != "open":
        who = f" by {row['reviewed_by']}" if row["reviewed_by"] else ""
        note = f": {row['note']}" if row["note"] else ""
        review = f"{row['verdict']}{who}{note}"
    return (
        row["anomaly_id"],
        row["priority"],
        row["kind"],
        row["flight_id"][:16],
        format_time(row["start_utc"], timezone),
        f"{row['first_frame_idx']}-{row['last_frame_idx']}",
        ",".join(map(str, row["evidence_frames"])),
        " ".join(where) or None,
        row["reason"],
        review,
    )
