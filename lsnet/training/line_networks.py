"""The networks of a line score, trained on examples: those of single proposals, and those of the context."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import nn

from lsnet.lines.context import LineContext, LineLayout, context_inputs, has_context
from lsnet.lines.perceptrons import MAX_DEVIATIONS, Perceptrons
from lsnet.training.line_scenes import SceneKind

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from torch import Tensor

    from lsnet.arrays import Floats, Floats32, Indices
    from lsnet.lines.score import LineScore
    from lsnet.training.line_scenes import Examples

BATCH, LEARNING_RATE, WEIGHT_DECAY = 512, 3e-3, 0.05
NOISE, DROPOUT = 0.1, 0.15  # noise of the features, in deviations
CONTEXT_KINDS = (SceneKind.TOWER, SceneKind.EMPTY)  # many wires in parallel, or none
CONTEXT_MEMBERS = 8  # that see the context, and as many that do not
CONTEXT_BLEND = (0.6, 0.1)  # factor of the evidence, and a constant


@dataclass(frozen=True, slots=True)
class NetworkRecipe:
    """Widths of the hidden layers, and epochs."""

    widths: tuple[int, ...]
    epochs: int


LINE_RECIPE, CONTEXT_RECIPE = NetworkRecipe((64, 32), 7), NetworkRecipe((16,), 12)


class LineScoreNet(nn.Module):
    """One network: inputs (N, F) to logits (N,)."""

    mean: Tensor
    deviation: Tensor

    def __init__(self, mean: Tensor, deviation: Tensor, widths: tuple[int, ...]) -> None:
        super().__init__()
        self.register_buffer("mean", mean)
        self.register_buffer("deviation", deviation)
        self.layers = [nn.Linear(a, b) for a, b in pairwise((len(mean), *widths, 1))]
        drops = [nn.Sequential(layer, nn.ReLU(), nn.Dropout(DROPOUT)) for layer in self.layers[:-1]]
        self.body = nn.Sequential(*drops, self.layers[-1])

    def forward(self, inputs: Tensor) -> Tensor:
        """Run a batch."""
        x = ((inputs - self.mean) / self.deviation).clamp(-MAX_DEVIATIONS, MAX_DEVIATIONS)
        out: Tensor = self.body(x)[:, 0]
        return out


def fit(
    inputs: Floats32, targets: Floats, lengths_px: Floats, seed: int, recipe: NetworkRecipe = LINE_RECIPE
) -> LineScoreNet:
    """Train a network on inputs (N, F); long lines count for more."""
    torch.manual_seed(seed)
    x, wanted = torch.from_numpy(inputs), torch.from_numpy(targets).float()
    importance = torch.from_numpy(np.sqrt(lengths_px / 100).clip(0.3, 4)).float()
    importance /= importance.mean()
    net = LineScoreNet(x.mean(dim=0), x.std(dim=0) + 0.02, recipe.widths)
    optimizer = torch.optim.AdamW(net.parameters(), lr=LEARNING_RATE, weight_decay=WEIGHT_DECAY)
    batches = max(1, len(wanted) // BATCH)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, recipe.epochs * batches)
    for _ in range(recipe.epochs):
        for batch in torch.randperm(len(wanted)).chunk(batches):
            noisy = x[batch] + torch.randn_like(x[batch]) * net.deviation * NOISE
            losses = nn.functional.binary_cross_entropy_with_logits(
                net(noisy), wanted[batch] * 0.98 + 0.01, reduction="none"
            )
            optimizer.zero_grad()
            (losses * importance[batch]).mean().backward()  # type: ignore[no-untyped-call]
            optimizer.step()
            schedule.step()
    return net.eval()


def as_perceptrons(nets: Sequence[LineScoreNet]) -> Perceptrons:
    """Return trained networks in the form of a weights file."""
    layers = range(len(nets[0].layers))
    return Perceptrons(
        np.stack([_array(net.mean[None]) for net in nets]),
        np.stack([_array(net.deviation[None]) for net in nets]),
        tuple(np.stack([_array(net.layers[k].weight.T) for net in nets]) for k in layers),
        tuple(np.stack([_array(net.layers[k].bias[None]) for net in nets]) for k in layers),
    )


def as_difference(seeing: Sequence[LineScoreNet], blind: Sequence[LineScoreNet]) -> Perceptrons:
    """Return one network: the mean of some networks of one hidden layer, less that of as many others.

    The others see only the first of the inputs.
    """
    nets, inputs = [*seeing, *blind], len(seeing[0].mean)
    hidden = [_array(net.layers[0].weight) for net in nets]
    rows = [np.pad(weight, ((0, 0), (0, inputs - weight.shape[1]))) for weight in hidden]
    factors = [1 / len(seeing)] * len(seeing) + [-1 / len(blind)] * len(blind)
    outputs = [_array(net.layers[1].weight.T) * factor for net, factor in zip(nets, factors, strict=True)]
    last = sum(_array(net.layers[1].bias) * factor for net, factor in zip(nets, factors, strict=True))
    return Perceptrons(
        _array(seeing[0].mean)[None, None],
        _array(seeing[0].deviation)[None, None],
        (np.concatenate(rows).T[None], np.concatenate(outputs)[None]),
        (
            np.concatenate([_array(net.layers[0].bias) for net in nets])[None, None],
            np.asarray(last, np.float32).reshape(1, 1, 1),
        ),
    )


def _array(tensor: Tensor) -> Floats32:
    return np.asarray(tensor.detach().numpy(), np.float32)


def fit_context(score: LineScore, examples: Examples, seed: int) -> LineContext | None:
    """Train the context of a score on whole scenes; None if they have too few proposals.

    Networks that see the context, less networks that do not, leave the evidence of the context alone: what
    both have learned of the scenes, in which wires are more or less frequent than elsewhere, cancels out.
    """
    examples = examples.of(CONTEXT_KINDS)
    scenes = [
        (rows, context_inputs(layout, learned, score.first_logits(learned, layout.priors)))
        for rows, layout, learned in each_scene(score, examples)
        if layout is not None
    ]
    rows = np.concatenate([each for each, _ in scenes]) if scenes else np.zeros(0, np.intp)
    if len(rows) < 2:
        return None
    inputs = np.concatenate([each for _, each in scenes])
    own = inputs[:, : len(score.networks) + 2]
    seeing, blind = (
        [
            fit(seen, examples.targets[rows], examples.lengths_px[rows], seed + k, CONTEXT_RECIPE)
            for k in range(CONTEXT_MEMBERS)
        ]
        for seen in (inputs, own)
    )
    return LineContext(as_difference(seeing, blind), np.array(CONTEXT_BLEND, np.float32))


def scores_of(score: LineScore, examples: Examples) -> Floats:
    """Return (N,) scores of the proposals of whole scenes."""
    logits = np.zeros(len(examples.targets))
    for rows, layout, learned in each_scene(score, examples):
        logits[rows] = score.logits(learned, examples.priors[rows], layout)
    out: Floats = 1 / (1 + np.exp(-logits))
    return out


def each_scene(score: LineScore, examples: Examples) -> Iterator[tuple[Indices, LineLayout | None, Floats32]]:
    """Yield which proposals a scene has, their layout if it is large enough for a context, their logits."""
    learned = score.networks.logits(examples.features)
    cuts = np.flatnonzero(np.diff(examples.scenes)) + 1
    for rows in np.split(np.arange(len(examples.scenes)), cuts):
        height, width = (int(side) for side in examples.image_sizes[rows[0]])
        layout = LineLayout(
            examples.ends[rows], examples.lengths_px[rows], examples.priors[rows], (height, width)
        )
        has = has_context((height, width), float(examples.enlargements[rows[0]]))
        yield rows, layout if has else None, learned[:, rows]
