"""Small networks of fully connected layers that run at once, as they are kept in a weights file."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from lsnet.arrays import Floats32

MAX_DEVIATIONS = 4.0  # inputs beyond are cut
_ROWS = 20  # at a time: for larger products BLAS wakes threads, which then spin for 0.1 s of CPU time each


@dataclass(frozen=True, slots=True, eq=False)
class Perceptrons:
    """M networks of F inputs and one output.

    Attributes:
        mean, deviation: (M, 1, F) of the inputs in training.
        weights, biases: Per layer (M, I, J) and (M, 1, J).
    """

    mean: Floats32
    deviation: Floats32
    weights: tuple[Floats32, ...]
    biases: tuple[Floats32, ...]

    def __post_init__(self) -> None:
        widths = [self.inputs, *(w.shape[-1] for w in self.weights)]
        if (
            [w.shape for w in self.weights] != [(len(self), a, b) for a, b in pairwise(widths)]
            or [b.shape for b in self.biases] != [(len(self), 1, b) for b in widths[1:]]
            or not self.mean.shape == self.deviation.shape == (len(self), 1, self.inputs)
            or widths[-1] != 1
        ):
            raise ValueError("tensors of the line score that do not fit")

    def __len__(self) -> int:
        return len(self.mean)

    @property
    def inputs(self) -> int:
        """Number of inputs."""
        return int(self.mean.shape[-1])

    def logits(self, inputs: Floats32) -> Floats32:
        """Return (M, C) logits of inputs (C, F)."""
        starts = range(0, max(len(inputs), 1), _ROWS)
        return np.concatenate([self._logits(inputs[i : i + _ROWS]) for i in starts], axis=1)

    def _logits(self, inputs: Floats32) -> Floats32:
        x = (inputs - self.mean) / self.deviation
        x = np.clip(x, -MAX_DEVIATIONS, MAX_DEVIATIONS)
        for weights, biases in zip(self.weights[:-1], self.biases[:-1], strict=True):
            x = np.maximum(x @ weights + biases, 0)
        out: Floats32 = (x @ self.weights[-1] + self.biases[-1])[..., 0]
        return out

    def tensors(self) -> dict[str, Floats32]:
        """Return the tensors by name."""
        named = {"mean": self.mean, "deviation": self.deviation}
        named |= {f"{k}.weight": w for k, w in enumerate(self.weights)}
        return named | {f"{k}.bias": b for k, b in enumerate(self.biases)}

    @classmethod
    def from_tensors(cls, named: dict[str, Floats32]) -> Perceptrons:
        """Read what `tensors` returns. Raises LookupError or ValueError for other tensors."""
        layers = range((len(named) - 2) // 2)
        read = cls(
            named["mean"],
            named["deviation"],
            tuple(named[f"{k}.weight"] for k in layers),
            tuple(named[f"{k}.bias"] for k in layers),
        )
        if named.keys() != read.tensors().keys():
            raise ValueError("unknown tensors of the line score")
        return read
