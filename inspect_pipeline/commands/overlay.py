"""`lsnet-pipe overlay`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from inspect_pipeline.commands.options import StoreOption


def overlay(
    flight: Annotated[str, typer.Argument(metavar="FLIGHT", help="A flight_id, or how it begins.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="The picture to write, PNG or JPEG.")],
    frame: Annotated[
        int | None, typer.Option(min=0, help="A frame_idx; by default the frame with the most lines.")
    ] = None,
    topic: Annotated[str | None, typer.Option(help="A camera topic; by default any.")] = None,
    segments: Annotated[bool, typer.Option("--segments", help="Draw raw segments instead of lines.")] = False,
    store: StoreOption = None,
) -> None:
    """Draw the lines of a frame onto it.

    Example: lsnet-pipe overlay 3f2a --frame 12 -o frame.png
    """
    from inspect_pipeline.images.draw import write_picture
    from inspect_pipeline.overlay import draw_overlay
    from inspect_pipeline.store.store import Store, store_path

    drawn = draw_overlay(Store(store_path(store)), flight, frame, topic=topic, segments=segments)
    write_picture(output, drawn.image)
    kind = "segments" if segments else "lines"
    typer.echo(f"{output}: frame {drawn.frame_idx} of {drawn.topic}, {drawn.n_drawn} {kind}")
