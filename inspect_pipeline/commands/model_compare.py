"""`lsnet-pipe model compare` and `ablate`: short trainings on the same drawn images."""

from __future__ import annotations

import json
from contextlib import contextmanager
from dataclasses import asdict
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from inspect_pipeline.commands.options import BackgroundOption, JsonOption, RunOption, RuntimeOption
from inspect_pipeline.commands.progress import progress_bar

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from lsnet.evaluation.compare.ablation import AblationRow
    from lsnet.evaluation.compare.compare import Row
    from lsnet.evaluation.compare.trainings import Comparison, Trainings


class CompareWhat(StrEnum):
    """Values of `model compare --what`."""

    NETWORKS = "networks"
    RIVALS = "rivals"


class Ablation(StrEnum):
    """Values of `model ablate --what`."""

    DOWNSAMPLE = "downsample"
    GRIDS = "grids"
    REGRESSION = "regression"
    CLASSIFICATION = "classification"


class Device(StrEnum):
    """Values of `--device`."""

    AUTO = "auto"
    CUDA = "cuda"
    CPU = "cpu"


def _check_thinner(number: int) -> int:
    """Refuse what the channels of the paper's networks cannot be divided by."""
    if number not in _THINNER:
        raise typer.BadParameter(f"{number} is not one of {', '.join(map(str, _THINNER))}")
    return number


_THINNER = (1, 2, 4, 8)
FoldersArgument = Annotated[list[Path], typer.Argument(metavar="DIR", help="Evaluation sets with truth.")]
ImagesOption = Annotated[int, typer.Option(min=1, metavar="N", help="Drawn images to train on.")]
StepsOption = Annotated[int, typer.Option(min=1, metavar="N", help="Batches to train each network on.")]
BatchOption = Annotated[int, typer.Option(min=1, metavar="N", help="Images in a batch.")]
CropOption = Annotated[int, typer.Option(min=64, metavar="PX", help="Side of the training images.")]
SeedsOption = Annotated[int, typer.Option(min=1, metavar="N", help="Trainings of each network.")]
ThinnerOption = Annotated[
    int,
    typer.Option(
        callback=_check_thinner,
        metavar="1|2|4|8",
        help="Divide the channels of the paper's networks by this.",
    ),
]
DeviceOption = Annotated[Device, typer.Option(help="Where to train. Default: a GPU if torch can use one.")]
MethodOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="NAME", help="Train only this beside LS-Net, named as in the table; may be repeated."
    ),
]
ThreadsOption = Annotated[int, typer.Option(min=1, metavar="N", help="Threads of the training process.")]
WorkersOption = Annotated[int, typer.Option(min=0, metavar="N", help="Processes that draw images.")]


def compare(
    folders: FoldersArgument,
    run: RunOption,
    what: Annotated[
        CompareWhat, typer.Option(help="Networks of several sizes, or LS-Net beside its rivals in the paper.")
    ] = CompareWhat.NETWORKS,
    background: BackgroundOption = None,
    images: ImagesOption = 3700,
    steps: StepsOption = 4000,
    batch_size: BatchOption = 4,
    crop: CropOption = 192,
    seeds: SeedsOption = 1,
    method: MethodOption = None,
    thinner: ThinnerOption = 4,
    device: DeviceOption = Device.AUTO,
    threads: ThreadsOption = 1,
    workers: WorkersOption = 1,
    chart: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write a chart of ODS over time, .svg or .png (extra plot)."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Compare networks after a short training.

    Networks of several sizes, scored by ODS and CPU time, or LS-Net with its rivals, scored by the ARR, APR
    and F1 of the paper, whose figures stand beside. All are trained on the same drawn images. Results are
    kept in the folder of the run: one that was killed continues when it is started again, and other data or
    options give other results.

    \b
    Examples:
      lsnet-pipe model compare photos/with_masks --run runs/compare --background photos:500
      lsnet-pipe model compare photos/with_masks --run runs/rivals --what rivals --seeds 3 --device cuda
    """
    from lsnet.evaluation.compare.compare import NETWORKS, compare_networks
    from lsnet.evaluation.compare.rivals import compare_rivals, count_rivals
    from lsnet.evaluation.compare.table import method_tables, network_table, write_chart
    from lsnet.evaluation.compare.trainings import Comparison

    of_rivals = what == CompareWhat.RIVALS
    _refuse_unused(chart, method, of_rivals=of_rivals)
    comparison = Comparison(
        run,
        tuple(background or ()),
        tuple(folders),
        images=images,
        steps=steps,
        batch_size=batch_size,
        crop=crop,
        device=device.value,
        threads=threads,
        as_paper=of_rivals,
    )
    if of_rivals:
        count = count_rivals(seeds, method or ())
        with _open_trainings("compare", comparison, count, workers) as trainings:
            methods = compare_rivals(trainings, thinner, seeds, method or ())
        _print_rows(methods, method_tables(methods), as_json=as_json)
        return
    with _open_trainings("compare", comparison, len(NETWORKS), workers) as trainings:
        networks = compare_networks(trainings, NETWORKS)
    if chart:
        write_chart(networks, chart)
    _print_rows(networks, network_table(networks), as_json=as_json)


def _refuse_unused(chart: Path | None, method: list[str] | None, *, of_rivals: bool) -> None:
    """Raise LSNetError for an option of the other comparison."""
    from lsnet.errors import LSNetError

    if of_rivals and chart:
        raise LSNetError("the chart is of the sizes of networks; leave out --chart or --what rivals")
    if method and not of_rivals:
        raise LSNetError(
            "networks of several sizes have no methods; leave out --method, or add --what rivals"
        )


@contextmanager
def _open_trainings(name: str, comparison: Comparison, n_networks: int, workers: int) -> Iterator[Trainings]:
    """Draw the images of a comparison, with a progress bar over the batches of its networks."""
    from lsnet.evaluation.compare.trainings import Trainings

    with progress_bar(name, n_networks * comparison.steps) as advance:
        yield Trainings(comparison, workers=workers, report=advance)


def _print_rows(rows: Sequence[AblationRow] | Sequence[Row], table: Sequence[str], *, as_json: bool) -> None:
    for line in [json.dumps(asdict(row)) for row in rows] if as_json else table:
        typer.echo(line)


def ablate(
    folders: FoldersArgument,
    run: Annotated[Path | None, typer.Option("--run", metavar="DIR", help="Folder of the trainings.")] = None,
    weights: Annotated[
        str | None,
        typer.Option(metavar="NAME|FILE", help="Instead of training, score the grids of these weights."),
    ] = None,
    runtime: RuntimeOption = "auto",
    what: Annotated[
        list[Ablation] | None, typer.Option(help="Ablation; may be repeated. Default: all four.")
    ] = None,
    background: BackgroundOption = None,
    images: ImagesOption = 3700,
    steps: StepsOption = 4000,
    batch_size: BatchOption = 8,
    crop: CropOption = 256,
    seeds: SeedsOption = 3,
    method: MethodOption = None,
    thinner: ThinnerOption = 4,
    device: DeviceOption = Device.AUTO,
    threads: ThreadsOption = 1,
    workers: WorkersOption = 1,
    as_json: JsonOption = False,
) -> None:
    """Repeat the ablations of the paper.

    Strides or pooling, grids, and the losses of endpoints and cells. Prints APR, ARR and F1 with the paper's
    protocol for ablations (segments 1 px wide, threshold 0.5), with the paper's own figures beside. Results
    are kept in the folder of the run, as those of `model compare`.

    \b
    Examples:
      lsnet-pipe model ablate photos/with_masks --weights fast
      lsnet-pipe model ablate photos/with_masks --run runs/ablate --background photos:500 --seeds 3
    """
    from lsnet.errors import LSNetError
    from lsnet.evaluation.compare import ablation
    from lsnet.evaluation.compare.table import method_tables
    from lsnet.evaluation.compare.trainings import Comparison
    from lsnet.evaluation.report import open_grids

    names = [name.value for name in what or Ablation]
    if weights is not None and run is None:
        if what and names != ["grids"]:
            raise LSNetError("only the ablation of the grids needs no training; give --run for the others")
        rows = ablation.ablate_grids(open_grids(weights, runtime), folders)
    elif run is not None and weights is None:
        comparison = Comparison(
            run,
            tuple(background or ()),
            tuple(folders),
            images=images,
            steps=steps,
            batch_size=batch_size,
            crop=crop,
            device=device.value,
            threads=threads,
            as_paper=True,
        )
        only, network = method or (), ablation.thin_paper(thinner)
        count = ablation.count_trainings(seeds, names, only)
        with _open_trainings("ablate", comparison, count, workers) as trainings:
            rows = ablation.ablate(trainings, network, seeds, names, only)
    else:
        raise LSNetError("give --run to train, or --weights to score the grids of trained weights")
    _print_rows(rows, method_tables(rows), as_json=as_json)
