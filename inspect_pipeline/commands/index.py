"""`lsnet-pipe index rebuild` and `lsnet-pipe index verify`."""

from __future__ import annotations

import typer

from inspect_pipeline.commands.options import StoreOption, open_store
from inspect_pipeline.commands.output import print_line, warn
from inspect_pipeline.errors import count_of

app = typer.Typer(
    help="Rebuild the index, or compare it with the flights.",
    epilog="Example: lsnet-pipe index verify",
    no_args_is_help=True,
)


@app.command()
def rebuild(store: StoreOption = None) -> None:
    """Rebuild the index from the flights, and the files made from it.

    Queries use the old index until the new one is complete.

    \b
    Examples:
      lsnet-pipe index rebuild --store /data/inspections
    """
    from inspect_pipeline.publishing import rebuild as rebuild_store

    change = rebuild_store(open_store(store))
    for folder, problem in change.damaged:
        warn(f"{folder}: left out: {problem}")
    print_line(count_of(change.n_flights, "flight"))
    if change.damaged:
        raise typer.Exit(1)


@app.command()
def verify(store: StoreOption = None) -> None:
    """Compare every row of the index with the flights.

    Exits with 1 and prints the differences when there are any.

    \b
    Examples:
      lsnet-pipe index verify
    """
    from inspect_pipeline.index import verify as verification

    problems = verification.verify(open_store(store))
    for problem in problems:
        print_line(problem)
    if problems:
        raise typer.Exit(1)
    print_line("the index is equal to the flights")
