"""`lsnet-pipe model`: draw training data, train and export networks; see `model_eval` for their scores."""

from __future__ import annotations

from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from inspect_pipeline.commands import model_compare, model_eval, model_figure, model_lines
from inspect_pipeline.commands.model_compare import Device, DeviceOption
from inspect_pipeline.commands.options import BackgroundOption, RunOption, RuntimeOption, WeightsOption
from inspect_pipeline.commands.progress import progress_bar

if TYPE_CHECKING:
    from lsnet.training.recipe import TrainingProgress

app = typer.Typer(
    help="Train, export, evaluate and time networks.",
    epilog="Example: lsnet-pipe model bench",
    no_args_is_help=True,
)


class Recipe(StrEnum):
    """Values of `--recipe`."""

    DEFAULT = "default"
    PAPER = "paper"


WeightsArgument = Annotated[
    str, typer.Argument(metavar="NAME|FILE", help="Name of shipped weights, or a .safetensors file.")
]


def train(
    run: RunOption,
    background: BackgroundOption = None,
    data: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Labelled images to train on, instead of drawn ones.")
    ] = None,
    rendered: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Pictures of `model synth` to paste over --background."),
    ] = None,
    validation: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Labelled images to validate on; required with --data.")
    ] = None,
    label: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Label that counts as a line; may be repeated. Default: all."),
    ] = None,
    recipe: Annotated[
        Recipe, typer.Option(help="Optimizer, schedule and augmentations; paper: those of the paper.")
    ] = Recipe.DEFAULT,
    preset: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Network: paper, fast, or a rival as wd-dcnn-gnfl. Default: fast, or that of the recipe.",
        ),
    ] = None,
    network: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=VALUE", help="Change the network, as downsample=pool; may be repeated."),
    ] = None,
    loss: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=VALUE", help="Change the loss, as gamma=1 or regression=l2; may be repeated."
        ),
    ] = None,
    longest: Annotated[
        bool,
        typer.Option(
            "--longest", help="Strictly the longest segment of a cell counts, as with --recipe paper."
        ),
    ] = False,
    steps: Annotated[int, typer.Option(min=1, metavar="N", help="Number of batches.")] = 10_000,
    batch_size: Annotated[int, typer.Option(min=1, metavar="N", help="Images in a batch.")] = 8,
    learning_rate: Annotated[
        float | None,
        typer.Option(min=0.0, metavar="RATE", help="Peak learning rate. Default: 0.002; paper: 0.0001."),
    ] = None,
    crop: Annotated[
        int | None,
        typer.Option(min=64, metavar="PX", help="Side of the training images. Default: 384; paper: 512."),
    ] = None,
    validate_every: Annotated[int, typer.Option(min=1, metavar="N", help="Steps between validations.")] = 500,
    seed: Annotated[
        int, typer.Option(min=0, max=999_999, metavar="N", help="Seed of the images and the initial weights.")
    ] = 0,
    device: DeviceOption = Device.AUTO,
    threads: Annotated[int, typer.Option(min=1, metavar="N", help="Threads of the training process.")] = 1,
    workers: Annotated[int, typer.Option(min=0, metavar="N", help="Processes that draw images.")] = 1,
    start: Annotated[
        str | None,
        typer.Option(
            metavar="WEIGHTS",
            help="Initial weights: a shipped name, a .safetensors file (also of a wider network) or best.pt.",
        ),
    ] = None,
) -> None:
    """Train a network on drawn, rendered or labelled images.

    Labels are labelme or COCO. A run that was killed continues when it is started again. Training stops when
    the validation loss no longer improves.

    \b
    Examples:
      lsnet-pipe model train --run runs/a --background photos:500
      lsnet-pipe model train --run runs/b --data rails/train --validation rails/val --start fast
      lsnet-pipe model train --run runs/c --recipe paper --preset paper --rendered renders --background photos
      lsnet-pipe model train --run runs/d --loss regression=l2 --network downsample=pool --preset paper
    """
    from lsnet.evaluation.baselines.learned import open_any_task
    from lsnet.training.recipe import RECIPES
    from lsnet.training.sources import TrainingData, open_sources
    from lsnet.training.trainer import Trainer

    is_paper = recipe == Recipe.PAPER
    defaults = RECIPES[recipe.value]
    sources = TrainingData(
        backgrounds=tuple(background or ()),
        data=data,
        validation=validation,
        labels=tuple(label or ()),
        size=crop or (512 if is_paper else 384),
        seed=seed,
        rendered=rendered,
        augmentation="paper" if is_paper else "all",
    )
    config = replace(
        defaults,
        preset=preset or defaults.preset,
        steps=steps,
        batch_size=batch_size,
        learning_rate=defaults.learning_rate if learning_rate is None else learning_rate,
        validate_every=validate_every,
        threads=threads,
        workers=workers,
        device=device.value,
        data=sources.describe(),
    )
    task = open_any_task(config.preset, network or (), loss or (), longest=longest or is_paper)
    train_on, validate_on = open_sources(sources)
    trainer = Trainer(config, run, seed=seed, start=start, task=task)
    with progress_bar("train", steps, done=trainer.step) as advance:
        trainer.run(train_on, validate_on, report=lambda state: advance(_describe(state), state.step))
    typer.echo(f"{run / 'best.pt'}: validation loss {trainer.best_loss:.4f}; next: lsnet-pipe model export")


def _describe(state: TrainingProgress) -> str:
    text = f"loss {state.loss:.3f} (cells {state.classification:.3f}, endpoints {state.regression:.3f})"
    if state.validation_loss is not None:
        text += f", validation {state.validation_loss:.4f} (cells {state.validation_classification:.4f}, "
        text += f"endpoints {state.validation_regression:.4f})"
    return f"{text}, {state.images_per_s:.1f} images/s"


def export(
    run: RunOption,
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="FILE", help="The .safetensors file to write.")
    ],
    name: Annotated[str, typer.Option(metavar="NAME", help="Name of the weights.")],
    min_score: Annotated[
        float, typer.Option(min=0.0, max=1.0, metavar="SCORE", help="Default score threshold.")
    ] = 0.5,
    metrics: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Output of `model eval --json` to keep in the file.")
    ] = None,
) -> None:
    """Write the best weights of a run to a file.

    \b
    Examples:
      lsnet-pipe model export --run runs/a --name mine -o mine.safetensors --min-score 0.4
    """
    from lsnet.training.sources import export_run

    sha256 = export_run(run, output, name, min_score, metrics)
    typer.echo(f"{output}: {name}, sha256 {sha256}")


def convert(weights: WeightsArgument) -> None:
    """Convert weights for OpenVINO, kept beside them.

    In f32 and int8. They then start without torch, and int8 without NNCF (extra `int8`), which converting
    needs. Weights that have changed since are converted at every start, as without this.

    \b
    Examples:
      lsnet-pipe model convert mine.safetensors
    """
    from lsnet.runtime.networks import write_networks
    from lsnet.weights_file import read_weights

    path = write_networks(read_weights(weights))
    typer.echo(f"{path}: {path.stat().st_size / 2**20:.1f} MiB")


def synth(
    output: Annotated[Path, typer.Option("--output", "-o", metavar="DIR", help="Folder to write to.")],
    count: Annotated[int, typer.Option(min=1, metavar="N", help="Number of pictures.")] = 100,
    light: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Environment maps (.hdr) to light with. Default: a sunny sky."),
    ] = None,
    size: Annotated[int, typer.Option(min=64, metavar="PX", help="Side of the square pictures.")] = 512,
    seed: Annotated[int, typer.Option(min=0, metavar="N", help="Seed of the pictures.")] = 0,
    workers: Annotated[int, typer.Option(min=1, metavar="N", help="Processes that render.")] = 1,
) -> None:
    """Render pictures of cables to train on.

    Writes PNG with alpha, and centrelines as JSON, for `--rendered` of `model train` and `model lines`. Needs
    the extra `synth`. A run that was killed continues when it is started again.

    \b
    Examples:
      lsnet-pipe model synth --count 1000 -o renders --light hdri --workers 8
    """
    from lsnet.synth.pbr.pictures import render_many

    with progress_bar("synth", count) as advance:
        render_many(output, count, lights=light, size=size, seed=seed, workers=workers, on_image=advance)
    typer.echo(f"{output}: {count} pictures; next: lsnet-pipe model train --rendered {output}")


def mine(
    background: BackgroundOption,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="DIR", help="Folder to write to.")],
    weights: WeightsOption = "fast",
    runtime: RuntimeOption = "auto",
    min_score: Annotated[
        float, typer.Option(min=0.0, max=1.0, metavar="SCORE", help="Minimum score of a false detection.")
    ] = 0.3,
    scale: Annotated[
        float | None,
        typer.Option(
            min=0.05,
            max=4.0,
            metavar="FACTOR",
            help="Resize photographs by this factor first. Default: one or several, by their size.",
        ),
    ] = None,
) -> None:
    """Cut hard negatives out of photographs without lines.

    These are squares in which the weights report segments; `model train` draws on them as on any background.

    \b
    Examples:
      lsnet-pipe model mine --background photos:500 -o hard
      lsnet-pipe model train --run runs/b --start fast --background photos:500 --background hard
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


app.command()(train)
app.command()(export)
app.command()(convert)
app.command(name="eval")(model_eval.evaluate)
app.command()(model_lines.lines)
app.command()(model_compare.compare)
app.command()(model_compare.ablate)
app.command()(synth)
app.command()(mine)
app.command()(model_eval.bench)
app.command(name="import")(model_eval.import_set)
app.add_typer(model_figure.app, name="figure")
