"""Options that several commands share, and how their values are parsed."""

from __future__ import annotations

import math
import re
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from inspect_pipeline.config import SchemaName, WriteMode

if TYPE_CHECKING:
    from inspect_pipeline.store.store import Store

PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg")
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def parse_time_ns(text: str) -> int:
    """Parse nanoseconds since 1970 or an ISO 8601 time, in UTC where it has no zone."""
    if text.isascii() and text.isdecimal():
        return int(text)
    try:
        time = datetime.fromisoformat(text)
    except ValueError:
        raise typer.BadParameter(
            f"{text!r} is neither nanoseconds nor a time like 2026-05-04T09:30:00Z"
        ) from None
    elapsed = (time if time.tzinfo else time.replace(tzinfo=UTC)) - _EPOCH
    return (elapsed.days * 86_400 + elapsed.seconds) * 10**9 + elapsed.microseconds * 1000


def finite(number: float | None) -> float | None:
    """Refuse nan and inf."""
    if number is not None and not math.isfinite(number):
        raise typer.BadParameter(f"{number} is not a finite number")
    return number


def open_store(option: Path | None, *, create: bool = False) -> Store:
    """Open the store of `--store`, else of LSNET_PIPE_STORE, else ./inspections.

    Args:
        option: the value of `--store`.
        create: whether the command may create the store; one that only reads must not, since a mistyped
            name would give an empty one.

    Raises:
        StoreError: there is no such store.
    """
    from inspect_pipeline.errors import StoreError
    from inspect_pipeline.store.store import Store, store_path

    store = Store(store_path(option))
    if not create and not store.root.exists():
        raise StoreError(store.root, "there is no store", "check the name, or run lsnet-pipe process first")
    return store


def _parse_signal(text: str) -> str:
    name, _, path = text.partition("=")
    if not (re.fullmatch(r"[A-Za-z_]\w*", name) and path):
        raise typer.BadParameter(f"{text!r} is not of the form NAME=PATH, as in battery=/battery.percentage")
    return text


def check_suffix(path: Path, known: tuple[str, ...]) -> None:
    """Refuse a name for a new file whose suffix says another format than the one that is written."""
    if path.suffix.lower() not in known:
        raise typer.BadParameter(f"{path} does not end in {' or '.join(known)}, the format of the file")


StoreOption = Annotated[
    Path | None,
    typer.Option(
        "--store", metavar="DIR", help="Folder of the store. Default: $LSNET_PIPE_STORE, else ./inspections."
    ),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON.")]
WeightsOption = Annotated[
    str, typer.Option(metavar="NAME|FILE", help="Name of shipped weights, or a .safetensors file.")
]
ScaleOption = Annotated[
    float | None,
    typer.Option(
        min=0.05,
        max=4.0,
        callback=finite,
        metavar="FACTOR",
        help="Resize images by this factor first. Default: one or several, by their size.",
    ),
]
MinScoreOption = Annotated[
    float | None,
    typer.Option(
        min=0.0,
        max=1.0,
        callback=finite,
        metavar="SCORE",
        help="Minimum score of a line. Default: that of the weights.",
    ),
]
DeviceOption = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="Device of torch: cpu, cuda or cuda:N. Default: a GPU, if any."),
]
RuntimeOption = Annotated[
    str,
    typer.Option(
        metavar="NAME",
        help="Inference runtime: auto, torch[-bf16|-f16] or openvino[-bf16|-int8].",
    ),
]
TopicOption = Annotated[
    list[str] | None,
    typer.Option(metavar="TOPIC", help="Camera topic; may be repeated. Default: all cameras."),
]
EveryOption = Annotated[int, typer.Option(min=1, metavar="N", help="Process every N-th frame.")]
StrictOption = Annotated[
    bool, typer.Option("--strict", help="Refuse damaged recordings instead of processing the readable part.")
]
WriteOption = Annotated[
    WriteMode,
    typer.Option(help="Write annotations to a copy of the recording, to a separate file, or not at all."),
]
SchemaOption = Annotated[
    SchemaName,
    typer.Option(help="Format of the annotations; auto: ROS 2 messages in ROS 2 bags, else protobuf."),
]
TrackSupportOption = Annotated[
    bool,
    typer.Option(
        "--track-support/--no-track-support", help="Let tracks decide on lines near the minimum score."
    ),
]
GroundAltOption = Annotated[
    float | None,
    typer.Option(
        "--ground-alt",
        callback=finite,
        metavar="METRES",
        help="Altitude of the ground, in the datum of the positions. Default: from the recording.",
    ),
]
DemOption = Annotated[
    Path | None,
    typer.Option(
        "--dem", metavar="FILE", help="Terrain model of the ground, as a GeoTIFF or ASCII grid (extra geo)."
    ),
]
ViewOption = Annotated[
    float | None,
    typer.Option(
        "--view",
        min=1.0,
        max=179.0,
        callback=finite,
        metavar="DEGREES",
        help="Horizontal field of view of cameras without calibration, or with a nominal lens.",
    ),
]
WireOption = Annotated[
    float,
    typer.Option(
        "--wire", min=0.1, callback=finite, metavar="MM", help="Diameter of a conductor, for its width in px."
    ),
]
SignalsOption = Annotated[
    list[str] | None,
    typer.Option(
        "--signals",
        parser=_parse_signal,
        metavar="NAME=PATH",
        help="Number to index with each frame, as in battery=/battery.percentage; may be repeated.",
    ),
]
FlightOption = Annotated[
    str | None,
    typer.Option(
        metavar="FLIGHT",
        help="Only this flight: its flight_id or its first characters, the name of its recording, or last.",
    ),
]
_FLIGHT_HELP = "A flight_id or its first characters, the name of its recording, or last."
FlightArgument = Annotated[str, typer.Argument(metavar="FLIGHT", help=_FLIGHT_HELP)]
OptionalFlightArgument = Annotated[str | None, typer.Argument(metavar="FLIGHT", help=_FLIGHT_HELP)]
PortOption = Annotated[
    int,
    typer.Option(
        min=0,
        max=65535,
        metavar="N",
        show_default=False,
        help="Port of this machine. Default: a free one.",
    ),
]
InboxArgument = Annotated[
    list[str], typer.Argument(metavar="INBOX", help="Folders, recordings, or globs in quotes.")
]
RunOption = Annotated[Path, typer.Option("--run", metavar="DIR", help="Folder of the run.")]
BackgroundOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="DIR[:FIRST]",
        help="Photographs without lines to draw on, the FIRST of them by name; may be repeated.",
    ),
]
