"""How `batch` tells what happens, on stderr: lines and a bar for people, or JSON for machines."""

from __future__ import annotations

import json
from contextlib import contextmanager
from datetime import UTC, datetime
from enum import StrEnum
from typing import TYPE_CHECKING

import typer

from inspect_pipeline.commands.progress import progress_bar

if TYPE_CHECKING:
    from collections.abc import Iterator

    from inspect_pipeline.batch.run import BatchReport
    from inspect_pipeline.commands.progress import Advance

_LINES = {
    "batch started": "{n_found} recordings in the inbox, {n_due} to look at",
    "recording done": "{path}: {status}, {n_frames} frames, {n_segments} segments, {duration_s:.1f} s",
    "recording damaged": "{path}: damaged: {reason}",
    "recording odd": "{path}: {warning}",
    "recording without images skipped": "{path}: skipped: {reason}",
    "recording quarantined": "{path}: in quarantine after attempt {attempts}, {reason}: {detail}",
    "recording changed while it was read": "{path}: changed while it was read, left for the next run",
    "recording still being written": "{path}: still being written, left for the next run",
    "link out of the inbox left alone": "{path}: leads out of the inbox, left alone",
    "folder of the inbox cannot be read": "{path}: cannot be read, left alone; check its rights",
    "annotated copy removed": "annotated copy of flight {flight_id:.16} removed",
    "index published": "index published, {n_flights} flights",
}
_ENDS = ("recording done", "recording quarantined", "recording changed while it was read")
_PROBLEMS = (
    *_ENDS[1:],
    "recording damaged",
    "recording odd",
    "link out of the inbox left alone",
    "folder of the inbox cannot be read",
)


class LogFormat(StrEnum):
    """What `--log-format` takes."""

    text = "text"
    json = "json"


def printable(text: str) -> str:
    """The text in one line that does nothing to a terminal; file and topic names may hold anything."""
    return "".join(c if c.isprintable() else "?" for c in text)


@contextmanager
def open_log(log_format: LogFormat) -> Iterator[BatchReport]:
    """A function to tell events to."""
    if log_format is LogFormat.json:
        yield _log_json
    else:
        with progress_bar("recordings", None) as advance:
            yield _TextLog(advance)


def _log_json(event: str, **fields: object) -> None:
    level = "error" if fields.get("error") else "warning" if event in _PROBLEMS else "info"
    line = {"ts": datetime.now(UTC).isoformat(), "level": level, "event": event, **fields}
    typer.echo(json.dumps(line), err=True)


class _TextLog:
    """Lines for people, and a bar that counts recordings."""

    def __init__(self, advance: Advance) -> None:
        self._advance = advance

    def __call__(self, event: str, **fields: object) -> None:
        if event == "batch started":
            self._advance(completed=0, total=int(str(fields["n_due"])))
        elif event in _ENDS:
            self._advance()
        if event == "batch finished":
            line = f"error: {fields['error']}" if fields["error"] else ""
        else:
            detail = str(fields.get("detail", "")).strip().splitlines()
            line = _LINES[event].format_map(fields | {"detail": detail[-1] if detail else ""})
        if line:
            typer.echo(printable(line), err=True)
