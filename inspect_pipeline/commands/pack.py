"""`lsnet-pipe pack`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def pack(
    source: Annotated[
        Path, typer.Argument(metavar="SOURCE", help="A folder of JPEGs, or a video with its SRT beside it.")
    ],
    target: Annotated[Path, typer.Argument(metavar="FILE", help="The recording to make (MCAP).")],
) -> None:
    """Make a recording of a drone's photographs or video, with the positions and gimbal angles they carry.

    Example: lsnet-pipe pack DCIM/100MEDIA flight.mcap
    """
    from inspect_pipeline import pack as packing

    result = packing.pack(source, target)
    for path in result.skipped:
        typer.echo(f"warning: {path} does not say when it was taken, it is left out", err=True)
    counts = f"{result.n_images} images, {result.n_positions} positions, {result.n_attitudes} attitudes"
    typer.echo(f"{target}: {counts}")
