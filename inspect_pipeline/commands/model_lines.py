"""`lsnet-pipe model lines`: train the line score of weights."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from inspect_pipeline.commands.options import BackgroundOption, WeightsOption
from inspect_pipeline.commands.progress import progress_bar


def lines(
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="FILE", help="The .safetensors file to write.")
    ],
    background: BackgroundOption = None,
    rendered: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Pictures of `model synth` to lay over --background."),
    ] = None,
    weights: WeightsOption = "fast",
    scenes: Annotated[int, typer.Option(min=1, metavar="N", help="Number of scenes to draw.")] = 6000,
    seed: Annotated[
        int, typer.Option(min=0, metavar="N", help="Seed of the scenes and the initial weights.")
    ] = 0,
    workers: Annotated[int, typer.Option(min=1, metavar="N", help="Processes that draw.")] = 1,
    context_only: Annotated[
        bool,
        typer.Option("--context-only", help="Keep the networks of the score; train what their context says."),
    ] = False,
) -> None:
    """Train the score of lines.

    The network of the weights proposes lines in drawn and rendered scenes and in photographs without wires;
    small networks learn which of them are wires, others what the proposals around one say about it. The
    network itself stays as it is. The last tenth of the photographs of each folder, and of the rendered
    pictures, is for validation only.

    \b
    Examples:
      lsnet-pipe model lines --background photos:500 --rendered renders -o better.safetensors
    """
    from lsnet.training.line_score import held_out_of, train_line_score

    with progress_bar("lines", scenes + held_out_of(scenes)) as advance:
        trained = train_line_score(
            weights,
            background or (),
            output,
            rendered=rendered,
            scenes=scenes,
            seed=seed,
            workers=workers,
            context_only=context_only,
            on_scene=advance,
        )
    if trained.validation:
        typer.echo(f"validation: {trained.validation}")
    typer.echo(f"{output}: sha256 {trained.sha256}; next: lsnet-pipe detect --weights {output}")
