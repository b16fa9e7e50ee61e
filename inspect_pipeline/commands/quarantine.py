"""`lsnet-pipe quarantine list`, `retry` and `clear`."""

from __future__ import annotations

import json
from typing import Annotated

import typer

from inspect_pipeline.commands.batch_log import printable
from inspect_pipeline.commands.options import JsonOption, StoreOption

app = typer.Typer(
    help="Recordings that batches have given up.",
    epilog="Example: lsnet-pipe quarantine list",
    no_args_is_help=True,
)


@app.command("list")
def list_notes(store: StoreOption = None, as_json: JsonOption = False) -> None:
    """Show which recordings were given up, and why.

    Example: lsnet-pipe quarantine list --json
    """
    from inspect_pipeline.batch.quarantine import Quarantine
    from inspect_pipeline.store.store import Store, store_path

    for note in Quarantine(Store(store_path(store))).notes():
        if as_json:
            typer.echo(json.dumps(note.to_json()))
        else:
            detail = note.detail.strip().splitlines()[-1]
            typer.echo(f"{note.note_id}  {note.at[:19]}  {note.reason:10}  {printable(detail)}")
            typer.echo(f"{'':18}{printable(note.path)}")


@app.command()
def retry(
    note_ids: Annotated[
        list[str], typer.Argument(metavar="ID...", help="As told by `quarantine list`, or `all`.")
    ],
    store: StoreOption = None,
) -> None:
    """Let the next batch try recordings again.

    Example: lsnet-pipe quarantine retry 42c8f628261a909a
    """
    from inspect_pipeline.batch.quarantine import Quarantine
    from inspect_pipeline.store.store import Store, store_path

    quarantine = Quarantine(Store(store_path(store)))
    notes = {note.note_id: note for note in quarantine.notes()}
    wanted = list(notes) if note_ids == ["all"] else note_ids
    unknown = [note_id for note_id in wanted if note_id not in notes]
    if unknown:
        raise typer.BadParameter(f"{unknown[0]!r} is not in quarantine; see lsnet-pipe quarantine list")
    for note_id in wanted:
        quarantine.remove(notes[note_id].path)
        typer.echo(printable(notes[note_id].path))


@app.command()
def clear(store: StoreOption = None) -> None:
    """Forget recordings that are gone, or were replaced since they were given up.

    Example: lsnet-pipe quarantine clear
    """
    from inspect_pipeline.batch.quarantine import Quarantine
    from inspect_pipeline.store.store import Store, store_path

    for note in Quarantine(Store(store_path(store))).remove_stale():
        typer.echo(printable(note.path))
