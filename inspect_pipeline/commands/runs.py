"""`lsnet-pipe runs`."""

from __future__ import annotations

import json

import typer

from inspect_pipeline.commands.batch_log import printable
from inspect_pipeline.commands.options import JsonOption, StoreOption

_ROW = (
    "{started:19}  {command:7}  {duration:>9}  {exit:>4}  {processed:>9}  {done:>11}  {failed:>6}"
    "  {quarantine:>10}  {left:>6}  {frames:>9}  {tags}"
)
_HEAD = {
    name: name for name in ("command", "exit", "processed", "failed", "quarantine", "left", "frames", "tags")
}


def runs(store: StoreOption = None, as_json: JsonOption = False) -> None:
    """Show every batch and `process` that has ended, oldest first, and what became of the recordings.

    Example: lsnet-pipe runs --json
    """
    from inspect_pipeline.store.runs import load_runs
    from inspect_pipeline.store.store import Store, store_path

    summaries = load_runs(Store(store_path(store)))
    if summaries and not as_json:
        typer.echo(_ROW.format(started="started", duration="seconds", done="done before", **_HEAD))
    for summary in summaries:
        if as_json:
            typer.echo(json.dumps(summary.to_json()))
            continue
        counts = summary.counts
        typer.echo(
            _ROW.format(
                started=f"{summary.run.started_at:%Y-%m-%d %H:%M:%S}",
                command=summary.run.command or "",
                duration=f"{summary.duration_s:.1f}",
                exit=summary.exit_code,
                processed=counts.n_processed,
                done=counts.n_skipped,
                failed=counts.n_failed,
                quarantine=counts.n_quarantined + counts.n_in_quarantine,
                left=counts.n_waiting + counts.n_left,
                frames=counts.n_frames,
                tags=printable(" ".join(f"{key}={value}" for key, value in (summary.run.tags or {}).items())),
            )
        )
