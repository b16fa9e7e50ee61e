"""`lsnet-pipe export`."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from inspect_pipeline.commands.options import OptionalFlightArgument, StoreOption, open_store
from inspect_pipeline.commands.output import print_line, warn
from inspect_pipeline.commands.progress import progress_bar
from inspect_pipeline.errors import count_of, printable

if TYPE_CHECKING:
    from inspect_pipeline.export.rows import Redaction, RedactMode
    from inspect_pipeline.store.store import Store


class What(StrEnum):
    """What is exported."""

    anomalies = "anomalies"
    evidence = "evidence"
    corrections = "corrections"
    frames = "frames"
    lines = "lines"
    spans = "spans"
    conductors = "conductors"
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
    jpeg = "jpeg"
    coco = "coco"
    labelme = "labelme"
    esri_oriented = "esri-oriented"
    rrd = "rrd"


class Redact(StrEnum):
    """What is done to coordinates."""

    drop = "drop"
    fuzz = "fuzz"


_IMAGES = {Form.jpeg, Form.coco, Form.labelme, Form.esri_oriented}
_STDOUT = Path("/dev/stdout")
_SUFFIXES = {
    ".geojson": Form.geojson,
    ".json": Form.geojson,
    ".gpkg": Form.gpkg,
    ".kml": Form.kml,
    ".csv": Form.csv,
    ".parquet": Form.parquet,
    ".geoparquet": Form.geoparquet,
    ".rrd": Form.rrd,
}


def export(
    output: Annotated[
        Path,
        typer.Option("--output", "-o", metavar="FILE|DIR", help="The file or folder to write; - for stdout."),
    ],
    flight: OptionalFlightArgument = None,
    every: Annotated[bool, typer.Option("--all", help="Export all flights of the store.")] = False,
    what: Annotated[What, typer.Option(help="What is exported.")] = What.anomalies,
    form: Annotated[
        Form | None, typer.Option("--format", help="Format. Default: as the suffix of the file says.")
    ] = None,
    anomaly: Annotated[
        str | None,
        typer.Option(
            metavar="ID", help="Export the recording around this anomaly, as .mcap; no FLIGHT needed."
        ),
    ] = None,
    redact: Annotated[
        Redact | None,
        typer.Option(help="Remove coordinates, or move all of them by one random offset."),
    ] = None,
    store: StoreOption = None,
) -> None:
    """Export what was found for other systems.

    \b
    Examples:
      lsnet-pipe export last -o anomalies.geojson
      lsnet-pipe export --all --what spans -o spans.gpkg
      lsnet-pipe export 3f2a --what evidence -o evidence
      lsnet-pipe export --anomaly 0a1b2c -o snippet.mcap
    """
    if sum((flight is not None, every, anomaly is not None)) != 1:
        raise typer.BadParameter("give a FLIGHT, such as last, or --all, or --anomaly ID")
    if output == Path("-"):
        output = _STDOUT
    if anomaly is not None:
        if redact or form or output.suffix.lower() not in {".mcap", ""}:
            raise typer.BadParameter(
                "--anomaly exports a recording as it is: name an .mcap file, without --format or --redact"
            )
        _export_snippet(open_store(store), anomaly, output)
        return
    chosen = _choose_format(output, what, form)
    source = open_store(store)
    flight_ids, redaction = _find_flights(source, flight), _to_redaction(redact)
    if chosen == Form.rrd:
        _export_rrd(source, flight_ids, output, redaction)
    elif what == What.corrections:
        _export_corrections(source, flight_ids, output, chosen)
    elif chosen in _IMAGES:
        _export_images(source, flight_ids, output, what, chosen, redaction)
    else:
        from inspect_pipeline.export.tables import MAP_FORMATS, export_rows

        rows = export_rows(source, flight_ids, what.value, output, form=chosen.value, redaction=redaction)
        n_nowhere = rows.n_rows - rows.n_placed if chosen.value in MAP_FORMATS else 0
        nowhere = f", {n_nowhere:,} without a place" if n_nowhere else ""
        _report(output, f"{count_of(rows.n_rows, 'row')} of {what.value}{nowhere}", redaction)


def _choose_format(output: Path, what: What, form: Form | None) -> Form:
    """Return the format, given or as the suffix says; refuse those that do not hold what is exported."""
    from inspect_pipeline.export.corrections import CORRECTION_FORMATS
    from inspect_pipeline.export.images import IMAGE_FORMATS
    from inspect_pipeline.export.tables import TABLE_FORMATS

    possible = {
        What.evidence: IMAGE_FORMATS,
        What.corrections: CORRECTION_FORMATS,
        What.frames: (*TABLE_FORMATS["frames"], "rrd", *IMAGE_FORMATS),
    }.get(what) or (*TABLE_FORMATS[what.value], "rrd")
    default = Form(possible[0]) if what in {What.evidence, What.corrections} else None
    chosen = form or _SUFFIXES.get(output.suffix.lower(), default)
    if chosen is None:
        raise typer.BadParameter(f"{output}: its suffix names no format; give --format {'|'.join(possible)}")
    if chosen.value not in possible:
        raise typer.BadParameter(f"{what} can be exported as {', '.join(possible)}, not as {chosen}")
    return chosen


def _find_flights(store: Store, name: str | None) -> list[str]:
    from inspect_pipeline.index.flights import find_flight, find_flights

    return find_flights(store, None) if name is None else [find_flight(store, name)]


def _to_redaction(mode: Redact | None) -> Redaction | None:
    if mode is None:
        return None
    from inspect_pipeline.export.rows import Redaction

    chosen: RedactMode = mode.value
    return Redaction.of(chosen)


def _export_snippet(store: Store, anomaly_id: str, output: Path) -> None:
    from inspect_pipeline.export.snippet import export_snippet
    from inspect_pipeline.index.anomalies import find_anomaly

    n_messages = export_snippet(store, find_anomaly(store, anomaly_id), output)
    _report(output, count_of(n_messages, "message"), None)


def _export_rrd(store: Store, flight_ids: list[str], output: Path, redaction: Redaction | None) -> None:
    from inspect_pipeline.export.rerun import export_rrd

    if len(flight_ids) != 1:
        raise typer.BadParameter("a recording of Rerun holds one flight: give a FLIGHT")
    _report(output, count_of(export_rrd(store, flight_ids[0], output, redaction), "image"), redaction)


def _export_images(
    store: Store, flight_ids: list[str], folder: Path, what: What, form: Form, redaction: Redaction | None
) -> None:
    from inspect_pipeline.export.images import export_images

    with progress_bar(folder.name, None) as advance:
        found = export_images(
            store,
            flight_ids,
            what.value,
            folder,
            form=form.value,
            redaction=redaction,
            on_progress=lambda done, total: advance(completed=done, total=total),
        )
    for failure in found.failures:
        warn(failure)
    _report(folder, count_of(found.n_images, "image"), redaction)
    if found.failures:
        raise typer.Exit(1)


def _export_corrections(store: Store, flight_ids: list[str], folder: Path, form: Form) -> None:
    from inspect_pipeline.export.corrections import export_corrections

    n_images, failures = export_corrections(store, flight_ids, folder, form.value)
    for failure in failures:
        warn(failure)
    _report(folder, count_of(n_images, "image"), None)
    if failures:
        raise typer.Exit(1)


def _report(output: Path, counts: str, redaction: Redaction | None) -> None:
    """Say what was written; on stderr where the export itself goes to stdout."""
    text = f"{output}: {counts}{f'; {redaction.note}' if redaction else ''}"
    if output == _STDOUT:
        typer.echo(printable(text), err=True)
    else:
        print_line(text)
