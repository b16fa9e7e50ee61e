"""`lsnet-pipe overlay`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from inspect_pipeline.commands.options import (
    PICTURE_SUFFIXES,
    OptionalFlightArgument,
    StoreOption,
    check_suffix,
    open_store,
)
from inspect_pipeline.commands.output import print_line
from inspect_pipeline.commands.progress import progress_bar
from inspect_pipeline.errors import count_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from inspect_pipeline.overlay import Overlay
    from inspect_pipeline.store.store import Store

_FILM_SUFFIX = ".mp4"
_MARGIN_S = 2  # of a film before and after an anomaly


def overlay(
    output: Annotated[
        Path,
        typer.Option(
            "--output", "-o", metavar="FILE|DIR", help="A picture (.png, .jpg), a video (.mp4), or a folder."
        ),
    ],
    flight: OptionalFlightArgument = None,
    frame: Annotated[
        int | None, typer.Option(min=0, metavar="N", help="A frame_idx. Default: the frame with most lines.")
    ] = None,
    topic: Annotated[str | None, typer.Option(metavar="TOPIC", help="A camera topic. Default: any.")] = None,
    anomaly: Annotated[
        str | None, typer.Option(metavar="ID", help="Draw the evidence of this anomaly; no FLIGHT needed.")
    ] = None,
    segments: Annotated[bool, typer.Option("--segments", help="Draw raw segments instead of lines.")] = False,
    store: StoreOption = None,
) -> None:
    """Draw the lines of frames onto them.

    They are coloured by track, with scores, anomalies, time and place. A picture has one frame, a folder and
    a video have all frames of a camera, or those that show the anomaly.

    \b
    Examples:
      lsnet-pipe overlay 3f2a --frame 12 -o frame.png
      lsnet-pipe overlay --anomaly 0a1b2c -o evidence.png
      lsnet-pipe overlay last -o flight.mp4
    """
    if (flight is None) == (anomaly is None) or (anomaly and (frame is not None or topic)):
        raise typer.BadParameter("give a FLIGHT, with --frame and --topic as needed, or --anomaly ID alone")
    is_film = output.suffix.lower() == _FILM_SUFFIX
    is_folder = not is_film and (output.is_dir() or not output.suffix)
    if not (is_film or is_folder):
        check_suffix(output, (*PICTURE_SUFFIXES, _FILM_SUFFIX))

    source = open_store(store)
    if anomaly:
        flight_id, frames = _find_evidence(
            source, anomaly, has_margin=is_film, is_single=not (is_film or is_folder)
        )
    else:
        flight_id, frames = _find_frames(source, flight or "", frame, topic)
    if is_film or is_folder:
        _write_all(output, source, flight_id, frames, segments=segments)
        return

    from inspect_pipeline.images.draw import write_picture
    from inspect_pipeline.overlay import draw_overlays

    best = max(frames, key=lambda row: (row["n_lines"], row["n_segments"], -row["frame_idx"]))
    drawn = next(draw_overlays(source, flight_id, [best], segments=segments))
    write_picture(output, drawn.image)
    found = count_of(drawn.n_drawn, "segment" if segments else "line")
    print_line(f"{output}: frame {drawn.frame_idx} of {drawn.topic}, {found}")


def _find_frames(
    store: Store, name: str, frame: int | None, topic: str | None
) -> tuple[str, list[dict[str, Any]]]:
    from inspect_pipeline.index.flights import find_flight
    from inspect_pipeline.overlay import select_frames

    flight_id = find_flight(store, name)
    return flight_id, select_frames(store, flight_id, frame, topic=topic)


def _find_evidence(
    store: Store, beginning: str, *, has_margin: bool, is_single: bool
) -> tuple[str, list[dict[str, Any]]]:
    """Return an anomaly's flight, and its evidence frames, the best of them, or all around them."""
    from inspect_pipeline.index.anomalies import find_anomaly
    from inspect_pipeline.overlay import select_frames

    anomaly = find_anomaly(store, beginning)
    own = [
        row
        for row in select_frames(store, anomaly["flight_id"])
        if row["channel_id"] == anomaly["channel_id"]
    ]
    if has_margin:
        first_ns, last_ns = anomaly["start_ns"] - _MARGIN_S * 10**9, anomaly["end_ns"] + _MARGIN_S * 10**9
        return anomaly["flight_id"], [row for row in own if first_ns <= row["log_time_ns"] <= last_ns]
    wanted = anomaly["evidence_frames"] or [anomaly["first_frame_idx"]]
    if is_single:
        from inspect_pipeline.report.evidence import load_evidence

        found = load_evidence(store, anomaly["flight_id"]).of_anomalies.get(anomaly["anomaly_id"])
        wanted = [found.frame_idx] if found else wanted
    return anomaly["flight_id"], [row for row in own if row["frame_idx"] in wanted]


def _write_all(
    output: Path, store: Store, flight_id: str, frames: Sequence[dict[str, Any]], *, segments: bool
) -> None:
    """Write all frames of the first camera among them to a video, or to pictures in a folder."""
    from inspect_pipeline.images.draw import write_picture
    from inspect_pipeline.images.film import write_film
    from inspect_pipeline.overlay import draw_overlays

    topic = frames[0]["topic"]
    own = [row for row in frames if row["topic"] == topic]
    with progress_bar(output.name, len(own)) as advance:

        def drawn() -> Iterator[Overlay]:
            for one in draw_overlays(store, flight_id, own, segments=segments):
                advance()
                yield one

        if output.suffix.lower() == _FILM_SUFFIX:
            n_drawn = write_film(output, ((one.log_time_ns, one.image) for one in drawn()))
        else:
            output.mkdir(parents=True, exist_ok=True)
            n_drawn = 0
            for one in drawn():
                write_picture(output / f"frame-{one.frame_idx:06d}.jpg", one.image)
                n_drawn += 1
    print_line(f"{output}: {count_of(n_drawn, 'frame')} of {topic}")
