"""`lsnet-pipe batch`."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from inspect_pipeline.commands.batch_log import LogFormat, open_log
from inspect_pipeline.commands.options import (
    DemOption,
    EveryOption,
    GroundAltOption,
    InboxArgument,
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
    finite,
    open_store,
    parse_time_ns,
)
from inspect_pipeline.commands.options_file import ConfigOption
from inspect_pipeline.commands.output import print_line
from inspect_pipeline.config import ExecutorName
from inspect_pipeline.errors import count_of

if TYPE_CHECKING:
    from inspect_pipeline.batch.options import BatchOptions
    from inspect_pipeline.batch.run import BatchReport
    from inspect_pipeline.batch.worker import Job
    from inspect_pipeline.store.runs import RunSummary
    from inspect_pipeline.store.store import Store


_MAX_DAYS = 36_500.0  # dates do not go back for ever


def _parse_tag(text: str) -> str:
    key, equals, value = text.partition("=")
    if not (key and equals and value):
        raise typer.BadParameter(f"{text!r} is not of the form KEY=VALUE, as in line=L12")
    return text


def batch(
    inbox: InboxArgument,
    store: StoreOption = None,
    config: ConfigOption = None,  # noqa: ARG001 - read by its callback
    since: Annotated[
        int | None,
        typer.Option(
            parser=parse_time_ns, metavar="TIME", help="Only files changed since then, in ns or ISO 8601."
        ),
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Print the recordings to process, and stop.")
    ] = False,
    limit: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="Process at most N recordings.")
    ] = None,
    executor: Annotated[
        ExecutorName, typer.Option(help="Workers on this machine, or in the Ray cluster of RAY_ADDRESS.")
    ] = "local",
    jobs: Annotated[
        int, typer.Option(min=1, metavar="N", help="Recordings at a time; each keeps several cores busy.")
    ] = 1,
    timeout: Annotated[
        float,
        typer.Option(min=0.1, callback=finite, metavar="SECONDS", help="Time limit of one attempt."),
    ] = 3600.0,
    max_attempts: Annotated[
        int,
        typer.Option(min=1, metavar="N", help="Attempts at a recording that kills its worker or times out."),
    ] = 3,
    settle: Annotated[
        float,
        typer.Option(
            min=0.0, callback=finite, metavar="SECONDS", help="Skip files that changed within this time."
        ),
    ] = 10.0,
    topic: TopicOption = None,
    every: EveryOption = 1,
    strict: StrictOption = False,
    write: WriteOption = "copy",
    schema: SchemaOption = "auto",
    ground_alt: GroundAltOption = None,
    dem: DemOption = None,
    view: ViewOption = None,
    wire: WireOption = 22.0,
    signals: SignalsOption = None,
    weights: WeightsOption = "fast",
    runtime: RuntimeOption = "auto",
    scale: ScaleOption = None,
    min_score: MinScoreOption = None,
    track_support: TrackSupportOption = True,
    tag: Annotated[
        list[str] | None,
        typer.Option(parser=_parse_tag, metavar="KEY=VALUE", help="Tag of the run; may be repeated."),
    ] = None,
    keep_annotated: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            max=_MAX_DAYS,
            callback=finite,
            metavar="DAYS",
            help="Remove annotated copies older than this.",
        ),
    ] = None,
    metrics: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write metrics for Prometheus, as in lsnet.prom.")
    ] = None,
    on_finish: Annotated[
        str | None,
        typer.Option(
            metavar="CMD", help="Run this program, without a shell, with the summary as JSON on its stdin."
        ),
    ] = None,
    reports: Annotated[
        bool,
        typer.Option(
            "--report", help="Write the report of each new flight into the folder reports of the store."
        ),
    ] = False,
    log_format: Annotated[LogFormat, typer.Option(help="Format of the log on stderr.")] = LogFormat.text,
) -> None:
    """Process every new recording of inboxes.

    Run it every night, and again after whatever stopped it: it skips what is done.

    \b
    Examples:
      lsnet-pipe batch /data/inbox --store /data/inspections
      lsnet-pipe batch "/mnt/*/DCIM" --jobs 2 --tag line=L12
      lsnet-pipe batch /data/inbox --dry-run
    """
    the_store = open_store(store, create=True)
    if metrics:
        from inspect_pipeline.batch.prometheus import check_metrics

        check_metrics(metrics)
    if not dry_run:
        with the_store.batch_lock():  # a second batch ends here, before the slow imports
            pass

    from inspect_pipeline.batch.options import BatchOptions
    from inspect_pipeline.batch.worker import Job, LoadDetector, threads_of
    from inspect_pipeline.config import PlacingOptions, ProcessOptions

    process_options = ProcessOptions(
        tuple(topic) if topic else None,
        every,
        strict=strict,
        write=write,
        schema=schema,
        placing=PlacingOptions(ground_alt, view, wire / 1000, dem),
        signals=dict(item.split("=", 1) for item in signals or ()),
        track_support=track_support,
    )
    threads = threads_of(jobs) if executor == "local" else None
    detector = LoadDetector(weights, scale, min_score, runtime, threads)
    job = Job(the_store.root, process_options, detector)
    options = BatchOptions(
        inboxes=tuple(inbox),
        since_ns=since or 0,
        limit=limit,
        executor=executor,
        n_workers=jobs,
        timeout_s=timeout,
        max_attempts=max_attempts,
        settle_s=settle,
        keep_annotated_days=keep_annotated,
        tags=dict(item.split("=", 1) for item in tag or ()),
    )
    with open_log(log_format) as report:
        if dry_run:
            _print_plan(the_store, job, options, report)
            return
        exit_code = _run(the_store, job, options, report, metrics=metrics, on_finish=on_finish)
        if reports:
            from inspect_pipeline.report.store_page import FOLDER, write_reports

            n_pages = write_reports(the_store)
            report("reports written", folder=os.fspath(the_store.root / FOLDER), n_pages=n_pages)
    raise typer.Exit(exit_code)


def _print_plan(store: Store, job: Job, options: BatchOptions, report: BatchReport) -> None:
    from inspect_pipeline.batch.run import plan_batch

    for candidate in plan_batch(store, job, options, report):
        print_line(os.fspath(candidate.path))


def _run(
    store: Store,
    job: Job,
    options: BatchOptions,
    report: BatchReport,
    *,
    metrics: Path | None,
    on_finish: str | None,
) -> int:
    """Run a batch, report its end, and return the exit code."""
    from inspect_pipeline.batch.run import run_batch
    from inspect_pipeline.batch.stop_request import stop_on_signals
    from inspect_pipeline.store.runs import notify

    with stop_on_signals() as stop:
        summary = run_batch(store, job, options, report, stop)
    _print_summary(summary)
    if metrics:
        from inspect_pipeline.batch.prometheus import write_metrics
        from inspect_pipeline.batch.quarantine import Quarantine
        from inspect_pipeline.store.runs import load_runs

        batches = [run for run in load_runs(store) if run.run.command == "batch"]
        write_metrics(metrics, batches, len(Quarantine(store).notes()))
    if on_finish:
        notify(on_finish, summary)
    return summary.exit_code


def _print_summary(summary: RunSummary) -> None:
    counts = summary.counts
    n_given_up = counts.n_quarantined + counts.n_in_quarantine
    bad = f" ({counts.n_bad_frames:,} bad)" if counts.n_bad_frames else ""
    failed = f" {counts.n_failed:,} failed (a camera without a good image)," if counts.n_failed else ""
    print_line(
        f"{count_of(counts.n_found, 'recording')}: {counts.n_processed:,} processed,"
        f" {counts.n_skipped:,} done before,{failed} {n_given_up:,} in quarantine,"
        f" {counts.n_waiting:,} still being written, {counts.n_left:,} left;"
        f" {count_of(counts.n_frames, 'frame')}{bad}, {count_of(counts.n_lines, 'line')},"
        f" {summary.duration_s:.1f} s"
    )
