"""`lsnet-pipe index rebuild` and `lsnet-pipe index verify`."""

from __future__ import annotations

import typer

from inspect_pipeline.commands.options import StoreOption

app = typer.Typer(
    help="Keep the index in step with the flights of the store.",
    epilog="Example: lsnet-pipe index verify",
    no_args_is_help=True,
)


@app.command()
def rebuild(store: StoreOption = None) -> None:
    """Make the index anew from the flights; queries go on meanwhile.

    Example: lsnet-pipe index rebuild --store /data/inspections
    """
    from inspect_pipeline.index import publish as index
    from inspect_pipeline.store.store import Store, store_path

    change = index.rebuild(Store(store_path(store)))
    for folder in change.damaged:
        typer.echo(f"{folder}: damaged and left out; process its recording again", err=True)
    typer.echo(f"{change.n_flights} flights")
    if change.damaged:
        raise typer.Exit(1)


@app.command()
def verify(store: StoreOption = None) -> None:
    """Compare every row of the index with the flights; exit 1 and say what differs.

    Example: lsnet-pipe index verify
    """
    from inspect_pipeline.index import publish as index
    from inspect_pipeline.store.store import Store, store_path

    problems = index.verify(Store(store_path(store)))
    for problem in problems:
        typer.echo(problem)
    if problems:
        raise typer.Exit(1)
    typer.echo("the index holds what the flights hold")
