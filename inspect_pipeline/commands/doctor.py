"""`lsnet-pipe doctor`."""

from __future__ import annotations

from typing import Annotated

import typer

from inspect_pipeline.commands.options import StoreOption
from inspect_pipeline.commands.output import print_line


def doctor(
    load: Annotated[bool, typer.Option("--load", help="Load the detector too, which takes seconds.")] = False,
    store: StoreOption = None,
) -> None:
    """Check versions, the detector and the store.

    Exits with 1 when something is wrong.

    \b
    Examples:
      lsnet-pipe doctor
      lsnet-pipe doctor --load --store /data/inspections
    """
    from inspect_pipeline.doctor import examine
    from inspect_pipeline.store.store import Store, store_path

    is_ok = True
    for finding in examine(Store(store_path(store)), load=load):
        is_ok = is_ok and finding.is_ok
        print_line(f"{'ok   ' if finding.is_ok else 'WRONG'}  {finding.subject:24}{finding.state}")
    if not is_ok:
        raise typer.Exit(1)
