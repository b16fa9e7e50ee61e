"""Training of the line score of weights, whose network stays as it is."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import nn

from lsnet.errors import LSNetError
from lsnet.lines.score import LineScore
from lsnet.training.line_scenes import SceneKind
from lsnet.training.line_sources import LineSource, collect
from lsnet.training.line_validation import validate
from lsnet.training.sources import VALIDATION_SEED
from lsnet.weights import load_network, save_weights
from lsnet.weights_file import read_weights

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from torch import Tensor

    from lsnet.arrays import Floats32
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
WIDTHS = (64, 32)
EPOCHS, BATCH, LEARNING_RATE, WEIGHT_DECAY = 7, 512, 3e-3, 0.05
NOISE, DROPOUT = 0.1, 0.15  # noise of the features, in deviations
MAX_DEVIATIONS = 4.0


class LineScoreNet(nn.Module):
    """One member: features (N, F) to logits (N,)."""

    mean: Tensor
    deviation: Tensor

    def __init__(self, mean: Tensor, deviation: Tensor) -> None:
        super().__init__()
        self.register_buffer("mean", mean)
        self.register_buffer("deviation", deviation)
        self.layers = [nn.Linear(a, b) for a, b in pairwise((len(mean), *WIDTHS, 1))]
        drops = [nn.Sequential(layer, nn.ReLU(), nn.Dropout(DROPOUT)) for layer in self.layers[:-1]]
        self.body = nn.Sequential(*drops, self.layers[-1])

    def forward(self, features: Tensor) -> Tensor:
        """Run a batch."""
        x = ((features - self.mean) / self.deviation).clamp(-MAX_DEVIATIONS, MAX_DEVIATIONS)
        out: Tensor = self.body(x)[:, 0]
        return out


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
        on_scene: Called after each scene of both.

    Raises:
        LSNetError: A folder or the weights cannot be used, the scenes have too few proposals, or the file
            cannot be written.
    """
    file = read_weights(weights)
    parts: tuple[tuple[Part, int, int], ...] = (
        ("training", seed, scenes),
        ("held out", seed + VALIDATION_SEED, held_out_of(scenes)),
    )
    trained_on, held_out = (
        collect(LineSource(weights, tuple(backgrounds), rendered, part, first), count, workers, on_scene)
        for part, first, count in parts
    )
    members = [trained_on.of(kinds) for kinds in MEMBERS] if trained_on else []
    if not members or min(len(member.targets) for member in members) < 2:
        raise LSNetError(f"too few proposals in {scenes} scenes to train on; draw more scenes")
    with one_thread():
        score = as_line_score([fit(member, seed + k) for k, member in enumerate(members)])
    validation = None
    if held_out:
        scores = score.scores(held_out.features, held_out.priors)
        validation = validate(held_out, scores, file.card.min_score)
    return TrainedLineScore(save_weights(output, load_network(file), file.card, score), validation)


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


def fit(examples: Examples, seed: int) -> LineScoreNet:
    """Train one member; long lines count for more."""
    torch.manual_seed(seed)
    features, targets = torch.from_numpy(examples.features), torch.from_numpy(examples.targets).float()
    importance = torch.from_numpy(np.sqrt(examples.lengths_px / 100).clip(0.3, 4)).float()
    importance /= importance.mean()
    net = LineScoreNet(features.mean(dim=0), features.std(dim=0) + 0.02)
    optimizer = torch.optim.AdamW(net.parameters(), lr=LEARNING_RATE, weight_decay=WEIGHT_DECAY)
    batches = max(1, len(targets) // BATCH)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, EPOCHS * batches)
    for _ in range(EPOCHS):
        for batch in torch.randperm(len(targets)).chunk(batches):
            noisy = features[batch] + torch.randn_like(features[batch]) * net.deviation * NOISE
            losses = nn.functional.binary_cross_entropy_with_logits(
                net(noisy), targets[batch] * 0.98 + 0.01, reduction="none"
            )
            optimizer.zero_grad()
            (losses * importance[batch]).mean().backward()  # type: ignore[no-untyped-call]
            optimizer.step()
            schedule.step()
    return net.eval()


def as_line_score(members: Sequence[LineScoreNet]) -> LineScore:
    """Return the trained members in the form of a weights file."""

    def stacked(tensors: Sequence[Tensor]) -> Floats32:
        return np.stack([np.asarray(tensor.detach().numpy(), np.float32) for tensor in tensors])

    layers = range(len(WIDTHS) + 1)
    return LineScore(
        stacked([net.mean[None] for net in members]),
        stacked([net.deviation[None] for net in members]),
        tuple(stacked([net.layers[k].weight.T for net in members]) for k in layers),
        tuple(stacked([net.layers[k].bias[None] for net in members]) for k in layers),
        np.array(BLEND, np.float32),
    )
