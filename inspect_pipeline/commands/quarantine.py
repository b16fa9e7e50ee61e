"""`lsnet-pipe quarantine list`, `retry` and `clear`."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Annotated

import typer

from inspect_pipeline.commands.options import JsonOption, StoreOption, open_store
from inspect_pipeline.commands.output import message_of, print_line, print_table
from inspect_pipeline.commands.times import TimezoneOption, format_time

if TYPE_CHECKING:
    from collections.abc import Sequence

    from inspect_pipeline.batch.quarantine import QuarantineNote

app = typer.Typer(
    help="List and retry recordings that batches gave up.",
    epilog="Example: lsnet-pipe quarantine list",
    no_args_is_help=True,
)


@app.command("list")
def list_notes(
    store: StoreOption = None, as_json: JsonOption = False, timezone: TimezoneOption = None
) -> None:
    """List the recordings in quarantine, and why.

    \b
    Examples:
      lsnet-pipe quarantine list
      lsnet-pipe quarantine list --json
    """
    from inspect_pipeline.batch.quarantine import Quarantine

    notes = Quarantine(open_store(store)).notes()
    if as_json:
        for note in notes:
            typer.echo(json.dumps(note.to_json()))
        return
    rows = [
        (
            note.note_id,
            format_time(note.at, timezone),
            note.reason,
            note.path,
            message_of(note.detail, note.path),
        )
        for note in notes
    ]
    print_table(("id", "since", "reason", "path", "detail"), rows, "no recordings in quarantine")


@app.command()
def retry(
    note_ids: Annotated[
        list[str],
        typer.Argument(metavar="ID", help="Ids of `quarantine list` or the start of them, or `all`."),
    ],
    store: StoreOption = None,
) -> None:
    """Let the next batch try recordings again.

    \b
    Examples:
      lsnet-pipe quarantine retry 42c8f628
      lsnet-pipe quarantine retry all
    """
    from inspect_pipeline.batch.quarantine import Quarantine

    quarantine = Quarantine(open_store(store))
    notes = quarantine.notes()
    wanted = notes if note_ids == ["all"] else [_find(notes, beginning) for beginning in note_ids]
    for note in wanted:
        quarantine.remove(note.path)
        print_line(note.path)


@app.command()
def clear(store: StoreOption = None) -> None:
    """Forget recordings that are gone or were replaced.

    \b
    Examples:
      lsnet-pipe quarantine clear
    """
    from inspect_pipeline.batch.quarantine import Quarantine

    for note in Quarantine(open_store(store)).remove_stale():
        print_line(note.path)


def _find(notes: Sequence[QuarantineNote], beginning: str) -> QuarantineNote:
    """Return the one note whose id begins so. Raises UnknownIdError, AmbiguousIdError."""
    from inspect_pipeline.errors import AmbiguousIdError, UnknownIdError

    found = [note for note in notes if beginning and note.note_id.startswith(beginning)]
    if not found:
        raise UnknownIdError("recording in quarantine", beginning, "quarantine list")
    if len(found) > 1:
        raise AmbiguousIdError("recording", beginning, len(found))
    return found[0]
