"""`lsnet-pipe model`: train, export, evaluate and time a network."""

from __future__ import annotations

import json
from dataclasses import asdict
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from inspect_pipeline.commands.options import JsonOption, RuntimeOption, WeightsOption
from inspect_pipeline.commands.progress import progress_bar

if TYPE_CHECKING:
    from lsnet.training.trainer import TrainingProgress

app = typer.Typer(
    help="Train, export, evaluate and time a network.",
    epilog="Example: lsnet-pipe model bench",
    no_args_is_help=True,
)

BackgroundOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="DIR[:FIRST]",
        help="Photographs without lines to draw on; FIRST takes so many, by name. May be repeated.",
    ),
]
RunOption = Annotated[Path, typer.Option("--run", metavar="DIR", help="The folder of the run.")]


@app.command()
def train(
    run: RunOption,
    background: BackgroundOption = None,
    data: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Labelled images instead of drawn ones.")
    ] = None,
    rendered: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Pictures of `model synth` to lay over --background."),
    ] = None,
    validation: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Labelled images to validate on, with --data.")
    ] = None,
    label: Annotated[list[str] | None, typer.Option(help="A label that counts as a line; else all.")] = None,
    preset: Annotated[str, typer.Option(help="paper or fast.")] = "fast",
    steps: Annotated[int, typer.Option(min=1, help="Batches in all.")] = 10_000,
    batch_size: Annotated[int, typer.Option(min=1)] = 8,
    learning_rate: Annotated[float, typer.Option(min=0.0)] = 2e-3,
    crop: Annotated[int, typer.Option(min=64, help="Side of the training images, px.")] = 384,
    validate_every: Annotated[int, typer.Option(min=1, help="Steps between validations.")] = 500,
    seed: Annotated[int, typer.Option(min=0, help="Same seed, same images and same first weights.")] = 0,
    threads: Annotated[int, typer.Option(min=1, help="Threads of the training itself.")] = 1,
    workers: Annotated[int, typer.Option(min=0, help="Processes that draw.")] = 1,
    start: Annotated[
        str | None,
        typer.Option(
            metavar="WEIGHTS",
            help="Begin with these: a shipped name, .safetensors (of a wider network too) or best.pt.",
        ),
    ] = None,
) -> None:
    """Train a network on drawn cables, or on your own labelled images (labelme or COCO).

    Kill it and run it again: it goes on where it was. It stops by itself when validation no longer improves.

    Example: lsnet-pipe model train --run runs/a --background photos:500

    Example: lsnet-pipe model train --run runs/b --data rails/train --validation rails/val --start fast
    """
    from lsnet.errors import LSNetError
    from lsnet.model import PRESETS
    from lsnet.training.sources import TrainingData, open_sources
    from lsnet.training.trainer import TrainConfig, Trainer

    if preset not in PRESETS:
        raise LSNetError(f"no preset {preset!r}; choose one of {', '.join(PRESETS)}")
    sources = TrainingData(
        tuple(background or ()), data, validation, tuple(label or ()), crop, seed, rendered
    )
    config = TrainConfig(
        preset=preset,
        steps=steps,
        batch_size=batch_size,
        learning_rate=learning_rate,
        validate_every=validate_every,
        threads=threads,
        workers=workers,
        data=sources.describe(),
    )
    train_on, validate_on = open_sources(sources)
    trainer = Trainer(config, run, seed=seed, start=start)
    with progress_bar("train", steps, done=trainer.step) as advance:
        trainer.run(train_on, validate_on, report=lambda state: advance(_telling(state), state.step))
    typer.echo(f"{run / 'best.pt'}: validation loss {trainer.best_loss:.4f}; next: lsnet-pipe model export")


def _telling(state: TrainingProgress) -> str:
    text = f"loss {state.loss:.3f} (cells {state.classification:.3f}, endpoints {state.regression:.3f})"
    if state.validation_loss is not None:
        text += f", validation {state.validation_loss:.4f}"
    return f"{text}, {state.images_per_s:.1f} images/s"


@app.command()
def export(
    run: RunOption,
    output: Annotated[Path, typer.Option("--output", "-o", help="The .safetensors file to write.")],
    name: Annotated[str, typer.Option(help="What the weights are called.")],
    min_score: Annotated[float, typer.Option(min=0.0, max=1.0, help="Their score threshold.")] = 0.5,
    metrics: Annotated[
        Path | None, typer.Option(help="JSON of `model eval --json`, kept in the file.")
    ] = None,
) -> None:
    """Write the best weights of a run with all that is needed to use them.

    Example: lsnet-pipe model export --run runs/a --name mine -o mine.safetensors --min-score 0.4
    """
    from lsnet.training.sources import export_run

    sha256 = export_run(run, output, name, min_score, metrics)
    typer.echo(f"{output}: {name}, sha256 {sha256}")


class Use(StrEnum):
    """What of the detections is scored."""

    SEGMENTS = "segments"
    LINES = "lines"


class What(StrEnum):
    """What is compared."""

    NETWORKS = "networks"
    ABLATIONS = "ablations"


@app.command(name="eval")
def evaluate(
    folders: Annotated[list[Path] | None, typer.Argument(metavar="DIR...", help="Evaluation sets.")] = None,
    weights: WeightsOption = "fast",
    runtime: RuntimeOption = "auto",
    use: Annotated[Use, typer.Option(help="Score raw segments or merged lines.")] = Use.SEGMENTS,
    min_score: Annotated[
        float | None, typer.Option(min=0.0, max=1.0, help="Also score at this; else the weights' own.")
    ] = None,
    paper: Annotated[
        bool, typer.Option("--paper", help="The paper's ARR, APR and F1 too, by width of lines.")
    ] = False,
    synthetic: Annotated[
        int, typer.Option(metavar="N", min=0, help="Also score N drawn images: sAP, and cable by cable.")
    ] = 0,
    background: BackgroundOption = None,
    rival: Annotated[
        str | None, typer.Option(metavar="NAME", help="Instead of weights: lsd, or M-LSD's .tflite file.")
    ] = None,
    grids: Annotated[
        str, typer.Option(metavar="LETTERS", help="Grids used: main, horizontal, vertical, central.")
    ] = "MHVC",
    as_json: JsonOption = False,
) -> None:
    """Score weights on folders of images, looked at as `detect` does.

    A folder holds ID.jpg with ID.boundary.png (contours of the cables), images/ with masks/, or plain images,
    of which the share with a reported segment or line is told. ODS is the best F1 over score thresholds.

    Example: lsnet-pipe model eval photos/with_masks photos/without_lines --use lines

    Example: lsnet-pipe model eval --synthetic 200 --background photos/without_lines
    """
    from lsnet.evaluation.report import EvalTask, evaluate_all, open_line_detector

    task = EvalTask(tuple(folders or ()), use.value, paper, synthetic, tuple(background or ()))
    finder, own = open_line_detector(weights, runtime, rival, grids)
    with progress_bar("eval", task.count_images()) as advance:
        reports = evaluate_all(finder, task, own if min_score is None else min_score, on_image=advance)
    for report in reports:
        typer.echo(json.dumps(report.to_dict()) if as_json else str(report))


@app.command()
def compare(
    folders: Annotated[list[Path], typer.Argument(metavar="DIR...", help="Evaluation sets with truth.")],
    run: RunOption,
    what: Annotated[What, typer.Option(help="Networks of several sizes, or the paper's choices.")] = (
        What.NETWORKS
    ),
    background: BackgroundOption = None,
    images: Annotated[int, typer.Option(min=1, help="Drawn images to train on.")] = 3700,
    steps: Annotated[int, typer.Option(min=1, help="Batches each is trained on.")] = 4000,
    workers: Annotated[int, typer.Option(min=0, help="Processes that draw.")] = 1,
    chart: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Also draw ODS over time, .svg or .png (extra plot).")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Train several networks or losses for a short while on the same drawn images; score and time each.

    Kill it and run it again: it goes on where it was.

    Example: lsnet-pipe model compare photos/with_masks --run runs/compare --background photos:500
    """
    from lsnet.evaluation.compare.compare import CANDIDATES, Comparison, compare_all
    from lsnet.evaluation.compare.table import table, write_chart

    comparison = Comparison(run, tuple(background or ()), tuple(folders), images, steps)
    candidates = CANDIDATES[what.value]
    with progress_bar("compare", len(candidates) * steps) as advance:
        rows = compare_all(comparison, candidates, workers=workers, report=advance)
    if chart:
        write_chart(rows, chart)
    for line in [json.dumps(asdict(row)) for row in rows] if as_json else table(rows):
        typer.echo(line)


@app.command()
def synth(
    output: Annotated[Path, typer.Option("--output", "-o", metavar="DIR", help="The folder to fill.")],
    count: Annotated[int, typer.Option(min=1, help="Pictures in all.")] = 100,
    light: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Environment maps (.hdr) for light; else a sunny sky."),
    ] = None,
    size: Annotated[int, typer.Option(min=64, help="Side of the square pictures, px.")] = 512,
    seed: Annotated[int, typer.Option(min=0, help="Same seed, same pictures.")] = 0,
    workers: Annotated[int, typer.Option(min=1, help="Processes that render.")] = 1,
) -> None:
    """Render cables physically: PNG with alpha and their centrelines as JSON, for `model train --rendered`.

    Kill it and run it again: it goes on where it was. Needs the extra `synth`.

    Example: lsnet-pipe model synth --count 1000 -o renders --light hdri --workers 8
    """
    from lsnet.synth.pbr.pictures import render_many

    with progress_bar("synth", count) as advance:
        render_many(output, count, lights=light, size=size, seed=seed, workers=workers, on_image=advance)
    typer.echo(f"{output}: {count} pictures; next: lsnet-pipe model train --rendered {output}")


@app.command()
def mine(
    background: BackgroundOption,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="DIR", help="The folder to fill.")],
    weights: WeightsOption = "fast",
    runtime: RuntimeOption = "auto",
    min_score: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="Least score of a segment that counts.")
    ] = 0.3,
    scale: Annotated[
        float | None,
        typer.Option(min=0.05, max=4.0, help="Resize photographs by this first; else small ones only."),
    ] = None,
) -> None:
    """Cut the squares with false alarms out of photographs without lines, to train on as hard negatives.

    Example: lsnet-pipe model mine --background photos:500 -o hard

    Example: lsnet-pipe model train --run runs/b --start fast --background photos:500 --background hard
    """
    from lsnet import Detector
    from lsnet.training.hard_negatives import mine, named_photos

    detector = Detector.load(weights, runtime=runtime, scale=scale, min_score=min_score)
    n_squares = 0
    with progress_bar("mine", len(named_photos(background or ()))) as advance:
        for found in mine(detector, background or (), output):
            n_squares += found
            advance(f"{n_squares} squares")
    typer.echo(f"{output}: {n_squares} squares; next: lsnet-pipe model train --background {output}")


@app.command()
def bench(
    size: Annotated[int, typer.Option(min=32, help="Side of the square images, px.")] = 512,
    images: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Photographs to use; else drawn scenes.")
    ] = None,
    seconds: Annotated[float, typer.Option(min=0.1, help="How long to measure.")] = 5.0,
    weights: WeightsOption = "fast",
    runtime: RuntimeOption = "auto",
    as_json: JsonOption = False,
) -> None:
    """Time detection, uint8 pixels in, segments and lines out.

    Example: lsnet-pipe model bench --json --size 512 --images photos
    """
    from lsnet.evaluation.speed import measure_speed

    result = measure_speed(weights, runtime, size, images, seconds)
    typer.echo(json.dumps(asdict(result)) if as_json else str(result))
