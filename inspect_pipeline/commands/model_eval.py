"""`lsnet-pipe model eval|compare|bench`: score and time networks."""

from __future__ import annotations

import json
from dataclasses import asdict
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from inspect_pipeline.commands.options import (
    BackgroundOption,
    JsonOption,
    RunOption,
    RuntimeOption,
    WeightsOption,
)
from inspect_pipeline.commands.progress import progress_bar


class Use(StrEnum):
    """Values of `--use`."""

    SEGMENTS = "segments"
    LINES = "lines"


class What(StrEnum):
    """Values of `--what`."""

    NETWORKS = "networks"
    ABLATIONS = "ablations"


def evaluate(
    folders: Annotated[list[Path] | None, typer.Argument(metavar="DIR...", help="Evaluation sets.")] = None,
    weights: WeightsOption = "fast",
    runtime: RuntimeOption = "auto",
    use: Annotated[Use, typer.Option(help="Score raw segments or merged lines.")] = Use.SEGMENTS,
    min_score: Annotated[
        float | None, typer.Option(min=0.0, max=1.0, help="Score threshold. Default: that of the weights.")
    ] = None,
    paper: Annotated[
        bool, typer.Option("--paper", help="Add ARR, APR and F1 of the paper, by line width.")
    ] = False,
    sigma: Annotated[
        float,
        typer.Option(
            min=0.1, max=20.0, metavar="PX", help="With --paper: width of the Gaussian before Otsu."
        ),
    ] = 1.0,
    synthetic: Annotated[
        int, typer.Option(metavar="N", min=0, help="Add N drawn images: sAP, and scores by cable.")
    ] = 0,
    background: BackgroundOption = None,
    rival: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Evaluate another detector: lsd, or the .tflite file of M-LSD."),
    ] = None,
    grids: Annotated[
        str | None,
        typer.Option(
            metavar="LETTERS", help="Grids to use: main, horizontal, vertical, central. Default: all, MHVC."
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Score weights on folders of images.

    A folder has ID.jpg with ID.boundary.png (contours of the cables), images/ with masks/, or images without
    truth, for which the share with a detection is reported. ODS is the best F1 over score thresholds. The
    scores of --paper are those of the segments from --min-score on.

    \b
    Examples:
      lsnet-pipe model eval photos/with_masks photos/without_lines --use lines
      lsnet-pipe model eval photos/with_masks --paper --min-score 0.5 --sigma 2
      lsnet-pipe model eval --synthetic 200 --background photos/without_lines
    """
    from lsnet.evaluation.report import EvalTask, evaluate_all, open_line_detector

    detector, own = open_line_detector(weights, runtime, rival, grids)
    task = EvalTask(
        folders=tuple(folders or ()),
        min_score=own if min_score is None else min_score,
        use=use.value,
        paper=paper,
        sigma_px=sigma,
        synthetic=synthetic,
        backgrounds=tuple(background or ()),
    )
    with progress_bar("eval", task.count_images()) as advance:
        reports = evaluate_all(detector, task, on_image=advance)
    for report in reports:
        typer.echo(json.dumps(asdict(report)) if as_json else str(report))


def compare(
    folders: Annotated[list[Path], typer.Argument(metavar="DIR...", help="Evaluation sets with truth.")],
    run: RunOption,
    what: Annotated[What, typer.Option(help="Networks of several sizes, or ablations of the paper.")] = (
        What.NETWORKS
    ),
    background: BackgroundOption = None,
    images: Annotated[int, typer.Option(min=1, help="Drawn images to train on.")] = 3700,
    steps: Annotated[int, typer.Option(min=1, help="Batches to train each network on.")] = 4000,
    workers: Annotated[int, typer.Option(min=0, help="Processes that draw images.")] = 1,
    chart: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write a chart of ODS over time, .svg or .png (extra plot)."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Compare networks or losses after a short training.

    All are trained on the same drawn images. A run that was killed continues when it is started again.

    \b
    Examples:
      lsnet-pipe model compare photos/with_masks --run runs/compare --background photos:500
    """
    from lsnet.evaluation.compare.compare import VARIANTS, Comparison, compare_all
    from lsnet.evaluation.compare.table import table, write_chart

    comparison = Comparison(run, tuple(background or ()), tuple(folders), images, steps)
    candidates = VARIANTS[what.value]
    with progress_bar("compare", len(candidates) * steps) as advance:
        rows = compare_all(comparison, candidates, workers=workers, report=advance)
    if chart:
        write_chart(rows, chart)
    for line in [json.dumps(asdict(row)) for row in rows] if as_json else table(rows):
        typer.echo(line)


def bench(
    size: Annotated[int, typer.Option(min=32, help="Side of the square images, px.")] = 512,
    images: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Photographs to use. Default: drawn scenes.")
    ] = None,
    seconds: Annotated[
        float, typer.Option(min=0.1, metavar="SECONDS", help="Duration of the measurement.")
    ] = 5.0,
    weights: WeightsOption = "fast",
    runtime: RuntimeOption = "auto",
    as_json: JsonOption = False,
) -> None:
    """Time detection, from pixels to lines.

    \b
    Examples:
      lsnet-pipe model bench --json --size 512 --images photos
    """
    from lsnet.evaluation.speed import measure_speed

    result = measure_speed(weights, runtime, size, images, seconds)
    typer.echo(json.dumps(asdict(result)) if as_json else str(result))
