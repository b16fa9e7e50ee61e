"""`lsnet-pipe process`."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from inspect_pipeline.commands.options import (
    JsonOption,
    MinScoreOption,
    ScaleOption,
    StoreOption,
    WeightsOption,
    parse_time_ns,
)

if TYPE_CHECKING:
    from inspect_pipeline.pipeline import Progress
    from inspect_pipeline.types import ProcessResult

_TABLE = (
    "{flight_id:16}  {status:9}  {n_frames:>8}  {n_bad_frames:>4}  {n_segments:>10}  {seconds:>8}  {source}"
)


def process(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help="Recordings (MCAP).")],
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
        bool, typer.Option(help="Refuse a damaged recording, or process what can be read of it.")
    ] = True,
    force: Annotated[bool, typer.Option("--force", help="Process again what is in the store.")] = False,
    weights: WeightsOption = "fast",
    scale: ScaleOption = None,
    min_score: MinScoreOption = None,
) -> None:
    """Find the lines in recordings: write them to annotated copies in the store, and index them.

    Example: lsnet-pipe process flight.mcap --store /data/inspections --json
    """
    from inspect_pipeline import config, index, pipeline
    from inspect_pipeline.errors import InspectError, StoreError
    from inspect_pipeline.store import Store, store_path
    from lsnet import Detector

    options = config.ProcessOptions(tuple(topic) if topic else None, every, start, end, strict, force)
    the_store = Store(store_path(store))
    detector = Detector.load(weights, scale=scale, min_score=min_score)
    run = config.start_run(detector, options)
    results, exit_code = [], 0
    for path in files:
        try:
            with _progress_bar(path) as on_progress:
                results.append(
                    pipeline.process(path, the_store, detector, options, run, on_progress=on_progress)
                )
        except InspectError as error:
            typer.echo(f"error: {error}", err=True)
            exit_code = error.exit_code
            if isinstance(error, StoreError):  # the next recording would fail alike
                break
    if results:
        index.publish(the_store)
    _print_results(results, as_json=as_json)
    raise typer.Exit(exit_code)


@contextmanager
def _progress_bar(path: Path) -> Iterator[Callable[[Progress], object]]:
    """A bar on stderr while a person is watching."""
    if not sys.stderr.isatty():
        yield lambda _: None
        return
    from rich import progress
    from rich.console import Console

    columns = (
        progress.TextColumn("{task.description}"),
        progress.BarColumn(),
        progress.MofNCompleteColumn(),
        progress.TextColumn("frames"),
        progress.TimeRemainingColumn(),
    )
    with progress.Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(path.name, total=None)
        yield lambda state: bar.update(task, completed=state.n_frames, total=state.n_expected)


def _print_results(results: list[ProcessResult], *, as_json: bool) -> None:
    if results and not as_json:
        typer.echo(_TABLE.format_map({name: name for name in results[0].__dataclass_fields__}))
    for result in results:
        if as_json:
            typer.echo(json.dumps(asdict(result), default=str))
        else:
            typer.echo(_TABLE.format_map(asdict(result) | {"flight_id": result.flight_id[:16]}))
