"""`lsnet-pipe detect`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from inspect_pipeline.commands.options import (
    JsonOption,
    MinScoreOption,
    RuntimeOption,
    ScaleOption,
    WeightsOption,
)
from inspect_pipeline.commands.progress import progress_bar

if TYPE_CHECKING:
    from inspect_pipeline.photos import Photograph


def detect(
    images: Annotated[list[Path], typer.Argument(metavar="IMAGE...", help="Photographs.")],
    as_json: JsonOption = False,
    min_score: MinScoreOption = None,
    scale: ScaleOption = None,
    batch_size: Annotated[int, typer.Option(min=1, max=256, help="Images read at a time.")] = 8,
    draw: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Write the lines over each image here, PNG.")
    ] = None,
    segments: Annotated[bool, typer.Option("--segments", help="Draw raw segments instead of lines.")] = False,
    confidence: Annotated[
        Path | None, typer.Option("--map", metavar="DIR", help="Write heat maps of confidence here, PNG.")
    ] = None,
    weights: WeightsOption = "fast",
    runtime: RuntimeOption = "auto",
) -> None:
    """Find the segments in photographs, in the pixels of each.

    Example: lsnet-pipe detect tower.jpg --json --min-score 0.3
    """
    from inspect_pipeline.photos import check_outputs, detect_in, write_map, write_overlay
    from lsnet import Detector

    check_outputs(images, draw, confidence)
    detector = Detector.load(weights, runtime=runtime, scale=scale, min_score=min_score)
    problems: list[str] = []
    with progress_bar("detect", len(images)) as advance:
        for photograph in detect_in(images, detector, batch_size, problems.append):
            advance()
            if draw:
                write_overlay(photograph, images, draw, segments=segments)
            if confidence:
                write_map(photograph, images, confidence)
            typer.echo(json.dumps(photograph.to_dict()) if as_json else _row(photograph))
    for problem in problems:
        typer.echo(f"error: {problem}", err=True)
    raise typer.Exit(1 if problems else 0)


def _row(photograph: Photograph) -> str:
    found = photograph.detections
    height, width = found.segments.image_size
    return f"{photograph.path}: {width}x{height}, {len(found.segments)} segments, {len(found.lines)} lines"
