"""`lsnet-pipe overlay`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from inspect_pipeline.commands.options import PICTURE_SUFFIXES, StoreOption, check_suffix, open_store
from inspect_pipeline.commands.output import count_of, print_line

if TYPE_CHECKING:
    from inspect_pipeline.store.store import Store


def overlay(
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="FILE", help="The picture to write, PNG or JPEG.")
    ],
    flight: Annotated[
        str | None, typer.Argument(metavar="FLIGHT", help="A flight_id or the start of it.")
    ] = None,
    frame: Annotated[
        int | None, typer.Option(min=0, metavar="N", help="A frame_idx. Default: the frame with most lines.")
    ] = None,
    topic: Annotated[str | None, typer.Option(metavar="TOPIC", help="A camera topic. Default: any.")] = None,
    anomaly: Annotated[
        str | None,
        typer.Option(metavar="ID", help="Draw the first evidence frame of this anomaly; no FLIGHT needed."),
    ] = None,
    segments: Annotated[bool, typer.Option("--segments", help="Draw raw segments instead of lines.")] = False,
    store: StoreOption = None,
) -> None:
    """Draw the lines of a frame onto it.

    \b
    Examples:
      lsnet-pipe overlay 3f2a --frame 12 -o frame.png
      lsnet-pipe overlay --anomaly 0a1b2c -o evidence.png
    """
    if (flight is None) == (anomaly is None) or (anomaly and (frame is not None or topic)):
        raise typer.BadParameter("give a FLIGHT, with --frame and --topic as needed, or --anomaly ID alone")
    check_suffix(output, PICTURE_SUFFIXES)

    source = open_store(store)
    if anomaly:
        flight_id, frame, topic = _find_evidence(source, anomaly)
    else:
        from inspect_pipeline.index.flights import find_flight

        flight_id = find_flight(source, flight or "")

    from inspect_pipeline.images.draw import write_picture
    from inspect_pipeline.overlay import draw_overlay

    drawn = draw_overlay(source, flight_id, frame, topic=topic, segments=segments)
    write_picture(output, drawn.image)
    found = count_of(drawn.n_drawn, "segment" if segments else "line")
    print_line(f"{output}: frame {drawn.frame_idx} of {drawn.topic}, {found}")


def _find_evidence(store: Store, beginning: str) -> tuple[str, int, str]:
    """Return flight_id, frame_idx and topic of the first evidence frame of an anomaly."""
    from inspect_pipeline.index.anomalies import find_anomaly
    from inspect_pipeline.index.reading import select

    anomaly = find_anomaly(store, beginning)
    key = [anomaly["flight_id"], anomaly["channel_id"]]
    (channel,) = select(store, "SELECT topic FROM channels WHERE flight_id = ? AND channel_id = ?", key)
    frames = anomaly["evidence_frames"] or [anomaly["first_frame_idx"]]
    return anomaly["flight_id"], frames[0], channel["topic"]
