"""`lsnet-pipe model figure`: the figures of the paper, of weights, rivals, runs and drawn images."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from inspect_pipeline.commands.options import (
    PICTURE_SUFFIXES,
    BackgroundOption,
    RuntimeOption,
    WeightsOption,
    check_suffix,
)

app = typer.Typer(
    help="Draw the figures of the paper.",
    epilog="Example: lsnet-pipe model figure grids photo.jpg -o grids.png",
    no_args_is_help=True,
)
OutputOption = Annotated[
    Path, typer.Option("--output", "-o", metavar="FILE", help="Picture to write, .png or .jpg.")
]
WidthOption = Annotated[int, typer.Option(min=32, metavar="PX", help="Width of each panel.")]


@app.command()
def detections(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Evaluation set, or a folder of images.")],
    output: OutputOption,
    weights: WeightsOption = "fast",
    rival: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="A rival as of `model eval`, to show too; may be repeated."),
    ] = None,
    runtime: RuntimeOption = "auto",
    count: Annotated[int, typer.Option(min=1, metavar="N", help="Number of images.")] = 3,
    width: WidthOption = 320,
) -> None:
    """Draw what weights and rivals find in a set, side by side.

    \b
    Examples:
      lsnet-pipe model figure detections photos/with_masks --rival lsd --rival runs/wd-dcnn -o side.png
    """
    from lsnet.evaluation.baselines.learned import LearnedRival
    from lsnet.evaluation.figures import detection_panels, montage, pixels_of_map, pixels_of_segments
    from lsnet.evaluation.report import open_line_detector
    from lsnet.files import write_png

    check_suffix(output, PICTURE_SUFFIXES)
    found = {}
    for name in (None, *(rival or ())):
        detector, min_score = open_line_detector(weights, runtime, name)
        label = Path(name).name if name else f"LS-Net ({Path(weights).stem})"
        if isinstance(detector, LearnedRival):
            found[label] = pixels_of_map(detector)
        else:
            found[label] = pixels_of_segments(detector, min_score)
    write_png(output, montage(detection_panels(folder, found, count), width))
    typer.echo(output)


@app.command()
def grids(
    image: Annotated[Path, typer.Argument(metavar="IMAGE", help="An image file.")],
    output: OutputOption,
    weights: WeightsOption = "fast",
    runtime: RuntimeOption = "auto",
    min_score: Annotated[
        float, typer.Option(min=0.0, max=1.0, metavar="SCORE", help="Score threshold.")
    ] = 0.5,
    width: WidthOption = 320,
) -> None:
    """Draw the segments of one, two, three and four grids.

    \b
    Examples:
      lsnet-pipe model figure grids photo.jpg -o grids.png
    """
    from lsnet.evaluation.figures import grid_panels, montage
    from lsnet.evaluation.report import open_grids
    from lsnet.files import write_png
    from lsnet.images import load_rgb

    check_suffix(output, PICTURE_SUFFIXES)
    panels = grid_panels(open_grids(weights, runtime), load_rgb(image), min_score)
    write_png(output, montage(panels, width))
    typer.echo(output)


@app.command()
def augmentations(
    output: OutputOption,
    background: BackgroundOption = None,
    size: Annotated[int, typer.Option(min=64, metavar="PX", help="Side of the drawn image.")] = 256,
    seed: Annotated[int, typer.Option(min=0, metavar="N", help="Seed of the image.")] = 0,
) -> None:
    """Draw a training image before and after each augmentation.

    \b
    Examples:
      lsnet-pipe model figure augmentations --background photos -o augmentations.png
    """
    from lsnet.evaluation.figures import augmentation_panels, montage
    from lsnet.files import write_png

    check_suffix(output, PICTURE_SUFFIXES)
    write_png(output, montage(augmentation_panels(background or (), size, seed), size))
    typer.echo(output)


@app.command()
def losses(
    runs: Annotated[list[Path], typer.Argument(metavar="RUN", help="Folders of runs.")],
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="FILE", help="Chart to write, .svg or .png.")
    ],
) -> None:
    """Draw the validation losses of runs over the steps.

    Of the cells (focal) and of the endpoints (Wing).

    \b
    Examples:
      lsnet-pipe model figure losses runs/stride runs/pool -o losses.svg
    """
    from lsnet.evaluation.figures import draw_losses

    draw_losses({run.name: run for run in runs}, output)
    typer.echo(output)
