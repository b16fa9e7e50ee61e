"""The log of `batch` on stderr: lines and a progress bar for people, or JSON for machines."""

from __future__ import annotations

import json
from contextlib import contextmanager
from datetime import UTC, datetime
from enum import StrEnum
from typing import TYPE_CHECKING

import typer

from inspect_pipeline.commands.output import message_of
from inspect_pipeline.commands.progress import progress_bar
from inspect_pipeline.errors import count_of, printable

if TYPE_CHECKING:
    from collections.abc import Iterator

    from inspect_pipeline.batch.run import BatchReport
    from inspect_pipeline.commands.progress import Advance

_LINES = {
    "batch started": "{n_found} in the inbox, {n_due} to process",
    "recording done": "{path}: {status}, {frames}, {lines}, {duration_s:.1f} s",
    "recording damaged": "{path}: damaged: {reason}",
    "recording failed": "{path}: failed: {reason}",
    "flight damaged": "{path}: left out of the index: {problem}",
    "recording odd": "{path}: {warning}",
    "recording without images skipped": "{path}: skipped: {reason}",
    "recording quarantined": "{path}: in quarantine after attempt {attempts}, {reason}: {detail}",
    "recording changed while it was read": "{path}: changed while it was read, left for the next run",
    "recording still being written": "{path}: still being written, left for the next run",
    "link out of the inbox left alone": "{path}: skipped, it links out of the inbox",
    "folder of the inbox cannot be read": "{path}: skipped, it cannot be read; check the permissions",
    "annotated copy removed": "annotated copy of flight {flight_id:.16} removed",
    "index published": "index published, {flights}",
    "reports written": "{folder}: {pages} written, and index.html",
}
_NOUNS = {"n_flights": "flight", "n_lines": "line", "n_found": "recording", "n_pages": "page"}
_ENDS = ("recording done", "recording quarantined", "recording changed while it was read")
_PROBLEMS = (
    *_ENDS[1:],
    "recording damaged",
    "recording failed",
    "flight damaged",
    "recording odd",
    "link out of the inbox left alone",
    "folder of the inbox cannot be read",
)


class LogFormat(StrEnum):
    """Values of `--log-format`."""

    text = "text"
    json = "json"


@contextmanager
def open_log(log_format: LogFormat) -> Iterator[BatchReport]:
    """Open a function that logs events."""
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
        line = _describe(event, fields)
        if line:
            typer.echo(printable(line), err=True)


def _describe(event: str, fields: dict[str, object]) -> str:
    if event == "batch finished":
        return f"error: {fields['error']}" if fields["error"] else ""
    texts = dict(fields)
    for name, noun in _NOUNS.items():
        if name in fields:
            texts[f"{noun}s"] = texts[name] = count_of(int(str(fields[name])), noun)
    if event == "recording done":
        bad = int(str(fields["n_bad_frames"]))
        frames = count_of(int(str(fields["n_frames"])), "frame")
        texts["frames"] = f"{frames} ({bad:,} bad)" if bad else frames
    detail = message_of(str(fields.get("detail", "")), str(fields.get("path", "")))
    return _LINES[event].format_map(texts | {"detail": detail})
