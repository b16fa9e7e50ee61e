"""`lsnet-pipe process`."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from inspect_pipeline.commands.detector import LateDetector
from inspect_pipeline.commands.options import (
    DemOption,
    DeviceOption,
    EveryOption,
    GroundAltOption,
    JsonOption,
    MinScoreOption,
    RuntimeOption,
    ScaleOption,
    SchemaOption,
    SignalsOption,
    StoreOption,
    StrictOption,
    TopicOption,
    TrackSupportOption,
    ViewOption,
    WeightsOption,
    WireOption,
    WriteOption,
    open_store,
    parse_time_ns,
)
from inspect_pipeline.commands.options_file import ConfigOption
from inspect_pipeline.commands.output import note, print_table, report_error, warn
from inspect_pipeline.commands.progress import progress_bar
from inspect_pipeline.errors import count_of

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from inspect_pipeline.config import ProcessOptions
    from inspect_pipeline.detection import StageTimes
    from inspect_pipeline.store.records import ProcessResult, RunRecord
    from inspect_pipeline.store.store import Store

_VIEWER_NOTE = "lsnet-pipe view last shows it in Lichtblick or Foxglove, with the lines switched on"


def process(
    files: Annotated[
        list[Path], typer.Argument(metavar="FILE", help="Recordings (MCAP), or folders of split ones.")
    ],
    store: StoreOption = None,
    config: ConfigOption = None,  # noqa: ARG001 - read by its callback
    as_json: JsonOption = False,
    topic: TopicOption = None,
    every: EveryOption = 1,
    start: Annotated[
        int | None, typer.Option(parser=parse_time_ns, metavar="TIME", help="First time, in ns or ISO 8601.")
    ] = None,
    end: Annotated[
        int | None, typer.Option(parser=parse_time_ns, metavar="TIME", help="End time, excluded.")
    ] = None,
    strict: StrictOption = False,
    write: WriteOption = "copy",
    schema: SchemaOption = "auto",
    force: Annotated[
        bool, typer.Option("--force", help="Process recordings that are in the store already.")
    ] = False,
    profile: Annotated[
        bool, typer.Option("--profile", help="Print the time of each stage on stderr.")
    ] = False,
    yes: Annotated[
        bool, typer.Option("--yes", help="Let a result without frames replace one with frames.")
    ] = False,
    ground_alt: GroundAltOption = None,
    dem: DemOption = None,
    view: ViewOption = None,
    wire: WireOption = 22.0,
    signals: SignalsOption = None,
    weights: WeightsOption = "fast",
    runtime: RuntimeOption = "auto",
    device: DeviceOption = None,
    scale: ScaleOption = None,
    min_score: MinScoreOption = None,
    track_support: TrackSupportOption = True,
) -> None:
    """Find the lines in recordings and index them.

    Annotated copies of the recordings are written to the store. What was lost of a damaged recording, and
    what is odd about one, is reported on stderr.

    \b
    Examples:
      lsnet-pipe process flight.mcap
      lsnet-pipe process *.mcap --store /data/inspections --json
      lsnet-pipe process flight.mcap --every 5 --topic /camera/image
      lsnet-pipe process flight.mcap --force --profile
    """
    if start is not None and end is not None and start >= end:
        raise typer.BadParameter("--end is not after --start")

    from inspect_pipeline.config import PlacingOptions, ProcessOptions, start_described_run
    from inspect_pipeline.store.runs import save_run, summarize_process

    options = ProcessOptions(
        tuple(topic) if topic else None,
        every,
        start,
        end,
        strict,
        force,
        write=write,
        schema=schema,
        placing=PlacingOptions(ground_alt, view, wire / 1000, dem),
        allow_empty=yes,
        signals=dict(item.split("=", 1) for item in signals or ()),
        track_support=track_support,
    )
    the_store = open_store(store, create=True)
    existing, exit_code = existing_files(files)
    if not existing:
        raise typer.Exit(exit_code)

    from inspect_pipeline.publishing import publish

    detector = LateDetector(weights, runtime, scale, min_score, device)
    run = start_described_run(detector.describe(), options, "process", {})
    results, n_failed, failure = _process_all(
        existing, lambda path: _process_one(path, the_store, detector, options, run, profile=profile)
    )
    exit_code, n_failed = failure or exit_code, n_failed + len(files) - len(existing)
    if any(result.status != "skipped" for result in results):
        save_run(
            the_store,
            summarize_process(run, results, n_found=len(files), n_failed=n_failed, exit_code=exit_code),
        )
    if results:
        publish(the_store)
        _warn_about_spans(the_store, results)
    _print_results(results, as_json=as_json)
    has_new_annotations = any(result.annotated and result.status != "skipped" for result in results)
    if has_new_annotations and not as_json and sys.stderr.isatty():
        note(_VIEWER_NOTE)
    raise typer.Exit(exit_code)


def existing_files(files: Sequence[Path]) -> tuple[list[Path], int]:
    """Return the recordings worth loading a detector for, and the exit code of the others' errors."""
    from inspect_pipeline.errors import InspectError
    from inspect_pipeline.recording.reader import check_recording

    existing, exit_code = [], 0
    for path in files:
        try:
            check_recording(path)
        except (InspectError, OSError) as error:
            exit_code = report_error(error, path) or exit_code
        else:
            existing.append(path)
    return existing, exit_code


def _process_one(
    path: Path,
    store: Store,
    detector: LateDetector,
    options: ProcessOptions,
    run: RunRecord,
    *,
    profile: bool,
) -> ProcessResult:
    """Process a recording with a progress bar, and print the times of its stages if asked for."""
    from inspect_pipeline import pipeline
    from inspect_pipeline.detection import StageTimes

    times = StageTimes()
    with progress_bar(path.name, None) as advance:
        result = pipeline.process(
            path,
            store,
            detector.load,
            options,
            run,
            on_progress=lambda state: advance(completed=state.n_frames, total=state.n_expected),
            on_wait=lambda: note(f"{path}: another process works on this flight; waiting for its end"),
            times=times,
        )
    if profile and result.status != "skipped":
        _print_profile(times, result.n_frames)
    return result


def _process_all(
    files: Sequence[Path], process_one: Callable[[Path], ProcessResult]
) -> tuple[list[ProcessResult], int, int]:
    """Process each file, and continue after a bad one.

    Returns:
        The results, the number of files without one, and the exit code.
    """
    from inspect_pipeline.errors import InspectError, StoreError

    results: list[ProcessResult] = []
    n_failed, exit_code = 0, 0
    for path in files:
        try:
            result = process_one(path)
        except (InspectError, OSError) as error:
            n_failed, exit_code = n_failed + 1, report_error(error, path) or 1
            if isinstance(error, StoreError):  # the next recording would fail alike
                break
        else:
            results.append(result)
            exit_code = 1 if result.status == "failed" else exit_code
            _warn_about(result)
    return results, n_failed, exit_code


def _print_profile(times: StageTimes, n_frames: int) -> None:
    """Print wall and CPU time of each stage; they overlap, so their shares of the wall may exceed 100 %."""
    wall_s, stages = times.wall_s, times.stages()
    lines = [f"{'stage':10}{'ms a frame':>12}{'of the wall':>13}{'CPU ms a frame':>16}"]
    for stage, (spent_s, cpu_s) in stages.items():
        share, ms, cpu_ms = spent_s / wall_s, spent_s * 1e3 / n_frames, cpu_s * 1e3 / n_frames
        lines.append(f"{stage:10}{ms:12.2f}{share:13.0%}{cpu_ms:16.2f}")
    total_cpu_s = sum(cpu_s for _, cpu_s in stages.values())
    lines.append(f"{'wall':10}{wall_s * 1e3 / n_frames:12.2f}{1:13.0%}{total_cpu_s * 1e3 / n_frames:16.2f}")
    typer.echo("\n".join(lines), err=True)


def _warn_about(result: ProcessResult) -> None:
    """Report what was lost of a recording, replaced in the store, and odd about it."""
    notes = [f"{result.status}: {result.reason}"] if result.reason else []
    for text in (*notes, *result.warnings):
        warn(f"{result.source}: {text}")
    if result.n_frames_replaced is not None and result.n_frames_replaced != result.n_frames:
        replaced = count_of(result.n_frames_replaced, "frame")
        warn(
            f"{result.source}: this result of {count_of(result.n_frames, 'frame')} replaces one of {replaced}"
        )


def _warn_about_spans(store: Store, results: Sequence[ProcessResult]) -> None:
    """Report which rules could not judge the spans that new flights passed."""
    from inspect_pipeline.index.check import rules_not_judged

    sources = {result.flight_id: result.source for result in results if result.status != "skipped"}
    for flight_id, details in rules_not_judged(store, list(sources)).items():
        for detail in details:
            warn(f"{sources[flight_id]}: {detail}")


def _print_results(results: Sequence[ProcessResult], *, as_json: bool) -> None:
    if as_json:
        for result in results:
            typer.echo(json.dumps(asdict(result), default=str))
    elif results:
        columns = ("status", "n_frames", "n_bad_frames", "n_lines", "seconds", "source")
        rows = [[result.flight_id[:16], *(getattr(result, name) for name in columns)] for result in results]
        print_table(("flight_id", *columns), rows, "")
