"""Training of the line score of weights, whose network stays as it is."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import torch

from lsnet.errors import LSNetError
from lsnet.lines.score import LineScore, read_line_score
from lsnet.training.line_networks import as_perceptrons, fit, fit_context, scores_of
from lsnet.training.line_scenes import SceneKind
from lsnet.training.line_sources import LineSource, collect
from lsnet.training.line_validation import validate
from lsnet.training.sources import VALIDATION_SEED
from lsnet.weights import load_network, save_weights
from lsnet.weights_file import read_weights

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from lsnet.synth.backgrounds import Part
    from lsnet.training.line_scenes import Examples
    from lsnet.training.line_validation import LineValidation

# A network on all scenes finds short wires at towers; those without towers are better on all other sets.
MEMBERS = (
    (SceneKind.CLUTTER, SceneKind.EMPTY),
    (SceneKind.PHOTOGRAPH, SceneKind.EMPTY),
    (SceneKind.RENDERED, SceneKind.CLUTTER, SceneKind.EMPTY),
    tuple(SceneKind),
    tuple(kind for kind in SceneKind if kind != SceneKind.TOWER),
)
BLEND = (0.08, 0.12, 0.02, 0.4, 0.25, 0.8, 0.2)  # factors of the members and of the prior, and a constant


@dataclass(frozen=True, slots=True)
class TrainedLineScore:
    """What was written, and how good it is on scenes over pictures and photographs that were held out."""

    sha256: str
    validation: LineValidation | None


def train_line_score(
    weights: str | Path,
    backgrounds: Sequence[str],
    output: Path,
    *,
    rendered: Path | None = None,
    scenes: int = 6000,
    seed: int = 0,
    workers: int = 1,
    context_only: bool = False,
    on_scene: Callable[[], None] = lambda: None,
) -> TrainedLineScore:
    """Train the line score of weights on drawn and rendered scenes, and write them with it.

    The last tenth of the photographs of each folder, and of the rendered pictures, is for validation only.

    Args:
        weights: Name of shipped weights, or a .safetensors file.
        backgrounds: Folders of photographs without lines, DIR or DIR:FIRST.
        output: The .safetensors file to write.
        rendered: Folder of `model synth`.
        scenes: To train on; a tenth as many more for validation.
        seed: Of the scenes and the initial weights.
        workers: Processes that draw.
        context_only: Whether the networks of the line score that the weights have are kept.
        on_scene: Called after each scene of both.

    Raises:
        LSNetError: A folder or the weights cannot be used, the scenes have too few proposals, or the file
            cannot be written.
    """
    file = read_weights(weights)
    kept = read_line_score(file) if context_only else None
    if context_only and not kept:
        raise LSNetError(f"{weights}: has no line score whose networks could be kept; train all of it")
    parts: tuple[tuple[Part, int, int], ...] = (
        ("training", seed, scenes),
        ("held out", seed + VALIDATION_SEED, held_out_of(scenes)),
    )
    trained_on, held_out = (
        collect(LineSource(weights, tuple(backgrounds), rendered, part, first), count, workers, on_scene)
        for part, first, count in parts
    )
    with one_thread():
        score = fit_score(trained_on, seed, kept) if trained_on else None
    if score is None:
        raise LSNetError(f"too few proposals in {scenes} scenes to train on; draw more scenes")
    validation = None
    if held_out:
        validation = validate(held_out, scores_of(score, held_out), file.card.min_score)
    return TrainedLineScore(save_weights(output, load_network(file), file.card, score), validation)


def fit_score(examples: Examples, seed: int, kept: LineScore | None = None) -> LineScore | None:
    """Train networks, unless those of another score are kept, and their context; None without examples."""
    if kept:
        return replace(kept, context=fit_context(kept, examples, seed))
    members = [examples.of(kinds) for kinds in MEMBERS]
    if min(len(member.targets) for member in members) < 2:
        return None
    nets = [fit(each.features, each.targets, each.lengths_px, seed + k) for k, each in enumerate(members)]
    score = LineScore(as_perceptrons(nets), np.array(BLEND, np.float32))
    return replace(score, context=fit_context(score, examples, seed))


@contextmanager
def one_thread() -> Iterator[None]:
    """Run torch on one thread: for networks this small, several wait for each other most of the time."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def held_out_of(scenes: int) -> int:
    """Return the number of scenes for validation."""
    return scenes // 10
