"""`lsnet-pipe process`."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from inspect_pipeline.commands.batch_log import printable
from inspect_pipeline.commands.options import (
    DemOption,
    GroundAltOption,
    JsonOption,
    MinScoreOption,
    ScaleOption,
    SchemaOption,
    StoreOption,
    ViewOption,
    WeightsOption,
    WireOption,
    WriteOption,
    parse_time_ns,
)
from inspect_pipeline.commands.progress import progress_bar

if TYPE_CHECKING:
    from inspect_pipeline.errors import InspectError
    from inspect_pipeline.store.records import ProcessResult

_VIEWER_NOTE = (
    "note: viewers hide annotations at first; in the settings of the Image panel switch on the topics "
    "that end in /lsnet/annotations (eye) and Sync annotations"
)
_ROW = (
    "{flight_id:16}  {status:9}  {n_frames:>8}  {n_bad_frames:>12}  {n_segments:>10}  {seconds:>7}  {source}"
)


def process(
    files: Annotated[
        list[Path], typer.Argument(metavar="FILE...", help="Recordings (MCAP), or folders of split ones.")
    ],
    store: StoreOption = None,
    as_json: JsonOption = False,
    topic: Annotated[
        list[str] | None,
        typer.Option(metavar="TOPIC", help="A camera topic, may be repeated; else all cameras."),
    ] = None,
    every: Annotated[int, typer.Option(min=1, metavar="N", help="Look at every N-th frame.")] = 1,
    start: Annotated[
        int | None, typer.Option(parser=parse_time_ns, metavar="TIME", help="First time, in ns or ISO 8601.")
    ] = None,
    end: Annotated[
        int | None, typer.Option(parser=parse_time_ns, metavar="TIME", help="End time, not included.")
    ] = None,
    strict: Annotated[
        bool, typer.Option("--strict", help="Refuse a damaged recording; else what can be read is processed.")
    ] = False,
    write: WriteOption = "copy",
    schema: SchemaOption = "auto",
    force: Annotated[bool, typer.Option("--force", help="Process again what is in the store.")] = False,
    ground_alt: GroundAltOption = None,
    dem: DemOption = None,
    view: ViewOption = None,
    wire: WireOption = 22.0,
    weights: WeightsOption = "fast",
    scale: ScaleOption = None,
    min_score: MinScoreOption = None,
) -> None:
    """Find the lines in recordings: write them to annotated copies in the store, and index them.

    What was lost of a damaged recording, and what is odd about one, is a warning on stderr.

    Example: lsnet-pipe process flight.mcap --store /data/inspections --json
    """
    if start is not None and end is not None and start >= end:
        raise typer.BadParameter("--end is not after --start")

    from inspect_pipeline import config
    from inspect_pipeline.errors import InspectError, StoreError
    from inspect_pipeline.store.store import Store, store_path

    options = config.ProcessOptions(
        tuple(topic) if topic else None,
        every,
        start,
        end,
        strict,
        force,
        write=write,
        schema=schema,
        placing=config.PlacingOptions(ground_alt, view, wire / 1000, dem),
    )
    the_store = Store(store_path(store))
    there, exit_code = _those_that_are_there(files)
    if not there:
        raise typer.Exit(exit_code)

    from inspect_pipeline import pipeline
    from inspect_pipeline.index import publish as index
    from inspect_pipeline.store.runs import save_run, summarize_process
    from lsnet import Detector

    detector = Detector.load(weights, scale=scale, min_score=min_score)
    run = config.start_run(detector, options)

    def process_one(path: Path) -> ProcessResult:
        with progress_bar(path.name, None) as advance:
            return pipeline.process(
                path,
                the_store,
                detector,
                options,
                run,
                on_progress=lambda state: advance(completed=state.n_frames, total=state.n_expected),
            )

    results, n_failed = [], len(files) - len(there)
    for path in there:
        try:
            results.append(process_one(path))
            _warn(results[-1])
        except (InspectError, OSError) as error:
            n_failed, exit_code = n_failed + 1, _tell(path, error)
            if isinstance(error, StoreError):  # the next recording would fail alike
                break
    if any(result.status != "skipped" for result in results):
        save_run(
            the_store,
            summarize_process(run, results, n_found=len(files), n_failed=n_failed, exit_code=exit_code),
        )
    if results:
        index.publish(the_store)
    _print_results(results, as_json=as_json)
    has_new_annotations = any(result.annotated and result.status != "skipped" for result in results)
    if has_new_annotations and not as_json and sys.stderr.isatty():
        typer.echo(_VIEWER_NOTE, err=True)
    raise typer.Exit(exit_code)


def _those_that_are_there(files: list[Path]) -> tuple[list[Path], int]:
    """The recordings that a detector is worth loading for; of the others the errors are told."""
    from inspect_pipeline.errors import InspectError
    from inspect_pipeline.recording.reader import check_recording

    there, exit_code = [], 0
    for path in files:
        try:
            check_recording(path)
        except (InspectError, OSError) as error:
            exit_code = _tell(path, error)
        else:
            there.append(path)
    return there, exit_code


def _tell(path: Path, error: InspectError | OSError) -> int:
    """Tell why a recording fails, also when it vanishes or its disk fails; the exit code."""
    if isinstance(error, OSError):
        told, exit_code = f"{path}: {error.strerror or error}; check the disk and its rights", 1
    else:
        told, exit_code = str(error), error.exit_code
    typer.echo(printable(f"error: {told}"), err=True)
    return exit_code


def _warn(result: ProcessResult) -> None:
    """Tell what was lost of a recording, and what is odd about it."""
    lost = [f"{result.status}: {result.reason}"] if result.reason else []
    for warning in (*lost, *result.warnings):
        typer.echo(printable(f"warning: {result.source}: {warning}"), err=True)


def _print_results(results: list[ProcessResult], *, as_json: bool) -> None:
    if results and not as_json:
        typer.echo(_ROW.format_map({name: name for name in results[0].__dataclass_fields__}))
    for result in results:
        if as_json:
            typer.echo(json.dumps(asdict(result), default=str))
        else:
            typer.echo(printable(_ROW.format_map(asdict(result) | {"flight_id": result.flight_id[:16]})))
