"""`lsnet-pipe detect`."""

from __future__ import annotations

import glob
import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from inspect_pipeline.commands.detector import LateDetector
from inspect_pipeline.commands.options import (
    JsonOption,
    MinScoreOption,
    RuntimeOption,
    ScaleOption,
    WeightsOption,
)
from inspect_pipeline.commands.output import print_line, report_error, warn
from inspect_pipeline.commands.progress import progress_bar
from inspect_pipeline.errors import count_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from inspect_pipeline.photos import Photograph

_SUFFIXES = {".jpg", ".jpeg", ".png", ".tif", ".tiff", ".bmp", ".webp"}


def detect(
    images: Annotated[
        list[str],
        typer.Argument(metavar="IMAGE", help="Photographs, folders of them, or globs in quotes."),
    ],
    as_json: JsonOption = False,
    min_score: MinScoreOption = None,
    scale: ScaleOption = None,
    batch_size: Annotated[
        int, typer.Option(min=1, max=256, metavar="N", help="Images in memory at a time.")
    ] = 8,
    draw: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Write each image with its lines here, as PNG.")
    ] = None,
    segments: Annotated[bool, typer.Option("--segments", help="Draw raw segments instead of lines.")] = False,
    confidence: Annotated[
        Path | None, typer.Option("--map", metavar="DIR", help="Write heat maps of confidence here, as PNG.")
    ] = None,
    weights: WeightsOption = "fast",
    runtime: RuntimeOption = "auto",
) -> None:
    """Find the lines in photographs.

    \b
    Examples:
      lsnet-pipe detect tower.jpg --json --min-score 0.3
      lsnet-pipe detect photos --draw drawn
      lsnet-pipe detect "photos/**/*.JPG" --map maps
    """
    paths, n_missing = _find_images(images)
    if not paths:
        raise typer.Exit(1)

    detector = LateDetector(weights, runtime, scale, min_score).load()
    from inspect_pipeline.photos import check_outputs, detect_in, write_map, write_overlay

    check_outputs(paths, draw, confidence)
    problems: list[str] = []
    with progress_bar("detect", len(paths)) as advance:
        for photograph in detect_in(paths, detector, batch_size, problems.append):
            advance()
            if photograph.doubt:
                warn(f"{photograph.path}: {photograph.doubt}")
            if draw:
                write_overlay(photograph, paths, draw, segments=segments)
            if confidence:
                write_map(photograph, paths, confidence)
            if as_json:
                typer.echo(json.dumps(photograph.to_dict()))
            else:
                print_line(_describe(photograph))
    for problem in problems:
        _report(problem)
    raise typer.Exit(1 if problems or n_missing else 0)


def _find_images(names: Sequence[str]) -> tuple[list[Path], int]:
    """Return the image files of names, and how many names have none, which is reported."""
    found: list[Path] = []
    n_missing = 0
    for name in names:
        paths = list(_expand(name))
        if not paths:
            what = "there is no image in it" if Path(name).is_dir() else "there is no such file"
            _report(f"{name}: {what}; check the name")
            n_missing += 1
        found += paths
    return found, n_missing


def _expand(name: str) -> Iterator[Path]:
    """Yield the file, the images below the folder, or those that match the glob."""
    path = Path(name)
    if path.is_dir():
        below = (each for each in sorted(path.rglob("*")) if each.is_file())
        yield from (each for each in below if each.suffix.lower() in _SUFFIXES and each.name[0] != ".")
    elif path.exists():
        yield path
    elif glob.has_magic(name):
        for match in sorted(glob.glob(name, recursive=True)):  # noqa: PTH207 - any root
            yield from _expand(match)


def _report(problem: str) -> None:
    from inspect_pipeline.errors import InspectError

    report_error(InspectError(problem))


def _describe(photograph: Photograph) -> str:
    height, width = photograph.detections.segments.image_size
    lines = count_of(len(photograph.detections.lines), "line")
    segments = count_of(len(photograph.detections.segments), "segment")
    return f"{photograph.path}: {width}x{height}, {lines} of {segments}"
