"""`lsnet-pipe model eval` and `bench`: how good and how fast weights and rivals are."""

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
    RuntimeOption,
    WeightsOption,
)
from inspect_pipeline.commands.progress import progress_bar


class Use(StrEnum):
    """Values of `--use`."""

    SEGMENTS = "segments"
    LINES = "lines"


def evaluate(
    folders: Annotated[list[Path] | None, typer.Argument(metavar="DIR", help="Evaluation sets.")] = None,
    weights: WeightsOption = "fast",
    runtime: RuntimeOption = "auto",
    use: Annotated[Use, typer.Option(help="Score raw segments or merged lines.")] = Use.SEGMENTS,
    min_score: Annotated[
        float | None,
        typer.Option(
            min=0.0, max=1.0, metavar="SCORE", help="Score threshold. Default: that of the weights."
        ),
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
        typer.Option(
            metavar="NAME",
            help="Evaluate another detector: lsd, hough, the .tflite file of M-LSD, or the run of a rival.",
        ),
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


def bench(
    size: Annotated[int, typer.Option(min=32, metavar="PX", help="Side of the square images.")] = 512,
    images: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Photographs to use. Default: drawn scenes.")
    ] = None,
    seconds: Annotated[
        float, typer.Option(min=0.1, metavar="SECONDS", help="Duration of the measurement.")
    ] = 5.0,
    weights: WeightsOption = "fast",
    preset: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Instead of weights, an untrained network: paper or fast."),
    ] = None,
    runtime: RuntimeOption = "auto",
    as_json: JsonOption = False,
) -> None:
    """Time detection, from pixels to lines.

    \b
    Examples:
      lsnet-pipe model bench --json --size 512 --images photos
      lsnet-pipe model bench --preset paper
    """
    from lsnet import Detector
    from lsnet.evaluation.speed import measure_speed, open_untrained

    if preset is None:
        detector = Detector.load(weights, runtime=runtime, scale=1.0)
    else:
        detector = open_untrained(preset, runtime)
    result = measure_speed(detector, size, images, seconds)
    typer.echo(json.dumps(asdict(result)) if as_json else str(result))


def import_set(
    source: Annotated[Path, typer.Argument(metavar="DIR", help="Images and masks as they were published.")],
    output: Annotated[Path, typer.Option("--output", "-o", metavar="DIR", help="Folder to write to.")],
) -> None:
    """Make an evaluation set of published images.

    A folder with images/ and masks/ is made of a folder of both. A mask has the name of its image, with or
    without a word as _gt or mask_, in the same folder or in one named gt, mask, label or ground_truth. Made
    for the Ground Truth of Power Line set of Yetgin and Gerek.

    \b
    Examples:
      lsnet-pipe model import downloads/powerline_gt -o sets/powerline_gt
      lsnet-pipe model eval sets/powerline_gt --paper
    """
    from lsnet.evaluation.conversion import convert_set, pairs_of

    with progress_bar("import", len(pairs_of(source)[0])) as advance:
        written, left_out = convert_set(source, output, on_image=advance)
    without = f"; {left_out} images without a mask left out" if left_out else ""
    typer.echo(f"{output}: {written} images{without}; next: lsnet-pipe model eval {output} --paper")
