"""Options that several commands share, and how their values are read."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer

from inspect_pipeline.config import SchemaName, WriteMode

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def parse_time_ns(text: str) -> int:
    """Nanoseconds since 1970 UTC, given as such or as an ISO 8601 time; without a zone it is in UTC."""
    if text.isdecimal():
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
    """The number; what is called nan and inf is none to work with."""
    if number is not None and not math.isfinite(number):
        raise typer.BadParameter(f"{number} is not a number to work with")
    return number


StoreOption = Annotated[
    Path | None,
    typer.Option("--store", metavar="DIR", help="The store; else LSNET_PIPE_STORE, else ./inspections."),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON.")]
WeightsOption = Annotated[str, typer.Option(metavar="NAME|FILE", help="Weights by name or by file.")]
ScaleOption = Annotated[
    float | None,
    typer.Option(
        min=0.05,
        max=4.0,
        callback=finite,
        metavar="FACTOR",
        help="Look at images of this size; else only small ones are enlarged.",
    ),
]
MinScoreOption = Annotated[
    float | None,
    typer.Option(
        min=0.0,
        max=1.0,
        callback=finite,
        metavar="SCORE",
        help="Least score of a segment; else the weights' own.",
    ),
]
WriteOption = Annotated[
    WriteMode,
    typer.Option(help="Annotations to a copy of the recording, a file of their own, or nowhere."),
]
SchemaOption = Annotated[
    SchemaName,
    typer.Option(help="Format of the annotations; auto: ROS 2 messages in ROS 2 bags, else protobuf."),
]
GroundAltOption = Annotated[
    float | None,
    typer.Option(
        "--ground-alt",
        callback=finite,
        metavar="METRES",
        help="Altitude of the ground as the positions count it; else as the recording says.",
    ),
]
DemOption = Annotated[
    Path | None,
    typer.Option(
        "--dem",
        metavar="FILE",
        help="A terrain model (GeoTIFF): how the ground rises from where a recording begins (extra geo).",
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
        help="From left to right of an image, for cameras without calibration.",
    ),
]
WireOption = Annotated[
    float,
    typer.Option(
        "--wire", min=0.1, callback=finite, metavar="MM", help="Diameter of a conductor, whose width is told."
    ),
]
RuntimeOption = Annotated[
    str, typer.Option(metavar="NAME", help="auto, torch, openvino, openvino-bf16 or openvino-int8.")
]
