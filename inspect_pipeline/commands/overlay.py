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
        int | None, typer.Option(min=0, help="A frame_idx; else the frame with the most segments.")
    ] = None,
    store: StoreOption = None,
) -> None:
    """Draw the segments of a frame onto it.

    Example: lsnet-pipe overlay 3f2a --frame 12 -o frame.png
    """
    from inspect_pipeline.overlay import draw_overlay, write_picture
    from inspect_pipeline.store.store import Store, store_path

    drawn = draw_overlay(Store(store_path(store)), flight, frame)
    write_picture(output, drawn.image)
    typer.echo(f"{output}: frame {drawn.frame_idx} of {drawn.topic}, {drawn.n_segments} segments")
