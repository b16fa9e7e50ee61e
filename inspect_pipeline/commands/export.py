"""`lsnet-pipe export`."""

from __future__ import annotations

import sys
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from inspect_pipeline.commands.options import StoreOption, open_store
from inspect_pipeline.commands.output import printable

if TYPE_CHECKING:
    from inspect_pipeline.export.rows import Redaction, RedactMode
    from inspect_pipeline.store.store import Store


class What(StrEnum):
    """What is exported."""

    anomalies = "anomalies"
    frames = "frames"
    lines = "lines"
    spans = "spans"
    gaps = "gaps"
    signals = "signals"


class Form(StrEnum):
    """The format of an export."""

    geojson = "geojson"
    gpkg = "gpkg"
    kml = "kml"
    csv = "csv"
    parquet = "parquet"
    geoparquet = "geoparquet"


class Redact(StrEnum):
    """What is done to coordinates."""

    drop = "drop"
    fuzz = "fuzz"


_SUFFIXES = {
    ".geojson": Form.geojson,
    ".json": Form.geojson,
    ".gpkg": Form.gpkg,
    ".kml": Form.kml,
    ".csv": Form.csv,
    ".parquet": Form.parquet,
    ".geoparquet": Form.geoparquet,
}


def export(
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="FILE", help="The file to write; - for stdout.")
    ],
    flight: Annotated[
        str | None,
        typer.Argument(
            metavar="FLIGHT", help="A flight_id or its start, the name of its recording, or last."
        ),
    ] = None,
    every: Annotated[bool, typer.Option("--all", help="Export all flights of the store.")] = False,
    what: Annotated[What, typer.Option(help="What is exported.")] = What.anomalies,
    form: Annotated[
        Form | None, typer.Option("--format", help="Format of the file. Default: as its suffix says.")
    ] = None,
    redact: Annotated[
        Redact | None,
        typer.Option(help="Remove coordinates, or move all of them by one random offset."),
    ] = None,
    store: StoreOption = None,
) -> None:
    """Export what was found for maps, spreadsheets and other systems.

    \b
    Examples:
      lsnet-pipe export last -o anomalies.geojson
      lsnet-pipe export --all --what spans -o spans.gpkg
      lsnet-pipe export 3f2a --what frames --redact fuzz -o frames.csv
    """
    if (flight is None) != every:
        raise typer.BadParameter("give a FLIGHT, such as last, or --all")
    if str(output) == "-":
        output = Path("/dev/stdout")
    source = open_store(store)
    flight_ids = _find_flights(source, flight)
    chosen = _choose_format(output, what, form)

    from inspect_pipeline.export.tables import export_rows

    redaction = _to_redaction(redact)
    rows = export_rows(source, flight_ids, what.value, output, form=chosen.value, redaction=redaction)
    _report(output, f"{rows.n_rows:,} {what.value}", rows.note)


def _find_flights(store: Store, name: str | None) -> list[str]:
    from inspect_pipeline.index.reading import select
    from inspect_pipeline.report.data import resolve_flight

    if name is not None:
        return [resolve_flight(store, name)]
    every = "SELECT flight_id FROM flights ORDER BY start_ns, flight_id"
    return [row["flight_id"] for row in select(store, every)]


def _choose_format(output: Path, what: What, form: Form | None) -> Form:
    """Return the format, given or as the suffix says; refuse those that do not hold what is exported."""
    from inspect_pipeline.export.tables import TABLE_FORMATS

    possible = TABLE_FORMATS[what.value]
    chosen = form or _SUFFIXES.get(output.suffix.lower())
    if chosen is None:
        raise typer.BadParameter(f"{output}: its suffix names no format; give --format {'|'.join(possible)}")
    if chosen.value not in possible:
        raise typer.BadParameter(f"{what} are exported as {', '.join(possible)}, not as {chosen}")
    return chosen


def _to_redaction(mode: Redact | None) -> Redaction | None:
    if mode is None:
        return None
    from inspect_pipeline.export.rows import Redaction

    chosen: RedactMode = mode.value
    return Redaction.of(chosen)


def _report(output: Path, counts: str, note: str | None) -> None:
    """Say what was written; on stderr where the export itself goes to stdout."""
    is_stdout = output == Path("/dev/stdout")
    text = f"{'stdout' if is_stdout else output}: {counts}{f'; {note}' if note else ''}"
    typer.echo(printable(text), err=is_stdout or (not sys.stdout.isatty() and is_stdout))
