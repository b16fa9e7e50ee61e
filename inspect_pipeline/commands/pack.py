"""`lsnet-pipe pack`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from inspect_pipeline.commands.options import check_suffix
from inspect_pipeline.commands.output import print_line, warn
from inspect_pipeline.errors import count_of


def pack(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="SOURCE", help="A folder of JPEGs, a video, or the folder of a split recording."
        ),
    ],
    target: Annotated[Path, typer.Argument(metavar="FILE", help="The recording to write (MCAP).")],
    timezone: Annotated[
        str | None,
        typer.Option(metavar="ZONE", help="Of clocks that say none: Europe/Berlin, +02:00. Default UTC."),
    ] = None,
    start: Annotated[
        str | None,
        typer.Option(metavar="TIME", help="When a video starts, as 2025-10-09T08:53:20 or with +02:00."),
    ] = None,
) -> None:
    """Convert photographs or video of a drone to a recording.

    Positions and gimbal angles come from EXIF and XMP, or from the SRT file beside the video. The parts of
    a split recording are joined.

    \b
    Examples:
      lsnet-pipe pack DCIM/100MEDIA flight.mcap
      lsnet-pipe pack DJI_0001.MP4 flight.mcap
    """
    check_suffix(target, (".mcap",))
    from datetime import datetime

    from inspect_pipeline.convert import pack as packing
    from inspect_pipeline.convert.times import parse_zone

    try:
        zone = parse_zone(timezone) if timezone else None
        begin = datetime.fromisoformat(start) if start else None
    except ValueError as error:
        raise typer.BadParameter(str(error)) from error
    result = packing.pack(source, target, zone=zone, start=begin)
    for warning in result.warnings:
        warn(warning)
    counts = (count_of(count, what.removesuffix("s")) for what, count in result.counts.items())
    print_line(f"{target}: {', '.join(counts)}")
