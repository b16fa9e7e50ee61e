"""`lsnet-pipe doctor`."""

from __future__ import annotations

import typer

from inspect_pipeline.commands.options import StoreOption


def doctor(store: StoreOption = None) -> None:
    """Show versions, the detector's backend and the state of the store; exit 1 when something is wrong.

    Example: lsnet-pipe doctor
    """
    from inspect_pipeline.doctor import examine
    from inspect_pipeline.store.store import Store, store_path

    is_ok = True
    for finding in examine(Store(store_path(store))):
        is_ok = is_ok and finding.is_ok
        typer.echo(f"{'ok   ' if finding.is_ok else 'WRONG'}  {finding.subject:24}{finding.state}")
    if not is_ok:
        raise typer.Exit(1)
