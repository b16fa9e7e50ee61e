"""How well a line score tells wires from other lines in held-out scenes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from lsnet.training.line_scenes import SceneKind

if TYPE_CHECKING:
    from lsnet.arrays import Mask, RealArray
    from lsnet.training.line_scenes import Examples


@dataclass(frozen=True, slots=True)
class LineValidation:
    """Quality on held-out scenes at one score.

    Attributes:
        f1: Per kind of scenes with wires, F of the length of what is reported. Recall is of what is proposed.
        false_share: Share of the scenes without wires, of those with proposals, that have a report.
    """

    f1: dict[SceneKind, float]
    false_share: float

    @property
    def mean_f1(self) -> float:
        """Mean over the kinds."""
        return float(np.mean(list(self.f1.values()))) if self.f1 else 0.0

    def __str__(self) -> str:
        parts = ", ".join(f"{kind.name.lower()} {f1:.3f}" for kind, f1 in self.f1.items())
        return f"F {self.mean_f1:.3f} ({parts}); {self.false_share:.0%} of scenes without wires with a report"


def validate(examples: Examples, scores: RealArray, min_score: float) -> LineValidation:
    """Judge scores (N,) of proposals."""
    is_reported = scores >= min_score
    f1: dict[SceneKind, float] = {
        kind: _f1(examples, is_reported, examples.kinds == kind)
        for kind in SceneKind
        if kind != SceneKind.EMPTY and (examples.kinds == kind).any()
    }
    is_empty = examples.kinds == SceneKind.EMPTY
    n_empty = len(np.unique(examples.scenes[is_empty]))
    n_false = len(np.unique(examples.scenes[is_empty & is_reported]))
    return LineValidation(f1, n_false / max(n_empty, 1))


def _f1(examples: Examples, is_reported: Mask, is_of_kind: Mask) -> float:
    """F of the length reported in scenes of a kind."""
    right_px = examples.lengths_px * examples.targets * is_of_kind
    reported_px = float((examples.lengths_px * is_of_kind * is_reported).sum())
    return 2 * float(right_px[is_reported].sum()) / max(reported_px + float(right_px.sum()), 1e-9)
