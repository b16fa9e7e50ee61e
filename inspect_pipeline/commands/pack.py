"""`lsnet-pipe pack`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from inspect_pipeline.commands.batch_log import printable


def pack(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="SOURCE", help="A folder of JPEGs, a video, or the folder of a split recording."
        ),
    ],
    target: Annotated[Path, typer.Argument(metavar="FILE", help="The recording to make (MCAP).")],
) -> None:
    """Make a recording of a drone's photographs, of its video and SRT, or of the parts of a split one.

    Positions and gimbal angles are taken from EXIF and XMP, and from the SRT file beside the video.

    Example: lsnet-pipe pack DCIM/100MEDIA flight.mcap
    """
    from inspect_pipeline.convert import pack as packing

    result = packing.pack(source, target)
    for warning in result.warnings:
        typer.echo(printable(f"warning: {warning}"), err=True)
    typer.echo(f"{target}: {', '.join(f'{count} {what}' for what, count in result.counts.items())}")
