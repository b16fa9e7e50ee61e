"""`lsnet-pipe runs`."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import typer

from inspect_pipeline.commands.options import JsonOption, StoreOption, open_store
from inspect_pipeline.commands.output import print_table
from inspect_pipeline.commands.times import TimezoneOption, format_time

if TYPE_CHECKING:
    from datetime import tzinfo

    from inspect_pipeline.store.runs import RunSummary

_HEADERS = (
    *("started", "command", "duration_s", "exit", "processed", "done_before", "failed", "quarantine"),
    *("left", "frames", "bad", "lines", "tags"),
)


def runs(store: StoreOption = None, as_json: JsonOption = False, timezone: TimezoneOption = None) -> None:
    """List every batch and process that ended, oldest first.

    \b
    Examples:
      lsnet-pipe runs
      lsnet-pipe runs --json
    """
    from inspect_pipeline.store.runs import load_runs

    summaries = load_runs(open_store(store))
    if as_json:
        for summary in summaries:
            typer.echo(json.dumps(summary.to_json()))
        return
    print_table(_HEADERS, [_to_row(summary, timezone) for summary in summaries], "no runs yet")


def _to_row(summary: RunSummary, timezone: tzinfo | None) -> tuple[object, ...]:
    counts = summary.counts
    return (
        format_time(summary.run.started_at, timezone),
        summary.run.command,
        round(summary.duration_s, 1),
        summary.exit_code,
        counts.n_processed,
        counts.n_skipped,
        counts.n_failed,
        counts.n_quarantined + counts.n_in_quarantine,
        counts.n_waiting + counts.n_left,
        counts.n_frames,
        counts.n_bad_frames,
        counts.n_lines,
        " ".join(f"{key}={value}" for key, value in (summary.run.tags or {}).items()),
    )
