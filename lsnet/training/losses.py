"""The multi-task loss of the paper (Section III-C): focal for the cells, Wing for the endpoints.

The other losses of its ablation (Section IV-B) are options of `MultiTaskLoss`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, NamedTuple

import torch
import torch.nn.functional as F

from lsnet.grid import IGNORED, POSITIVE

if TYPE_CHECKING:
    from torch import Tensor

    from lsnet.model import RawOutput

SWAPPED = [2, 3, 0, 1]  # the two ends in the other order
MIN_POSITIVE_SHARE = 0.01  # of the cells of a batch, in the denominator of its loss


def focal_loss(logits: Tensor, is_positive: Tensor, alpha: float, gamma: float) -> Tensor:
    """Return -alpha_t (1 - p_t)^gamma log p_t, elementwise (Lin et al.).

    Args:
        logits: (N, 2), without and with a segment.
        is_positive: (N,) bool.
        alpha: Weight of positive cells; that of the others is 1 - alpha.
        gamma: Focusing parameter; 0, with alpha 0.5, gives half the cross-entropy.
    """
    log_p = F.log_softmax(logits, dim=1)
    log_p_t = torch.where(is_positive, log_p[:, 1], log_p[:, 0])
    alpha_t = torch.where(is_positive, alpha, 1 - alpha)
    return -alpha_t * (1 - log_p_t.exp()) ** gamma * log_p_t


def wing_loss(error: Tensor, w: float, epsilon: float) -> Tensor:
    """Return the Wing loss, logarithmic below w, linear above, elementwise on errors d >= 0 (Feng et al.)."""
    offset = w - w * math.log(1 + w / epsilon)
    return torch.where(error < w, w * torch.log1p(error / epsilon), error - offset)


def left_to_right(endpoints: Tensor) -> Tensor:
    """Return (N, 4) endpoints x1 y1 x2 y2 with the smaller x first."""
    is_ordered = (endpoints[:, 0] <= endpoints[:, 2])[:, None]
    return torch.where(is_ordered, endpoints, endpoints[:, SWAPPED])


class LossParts(NamedTuple):
    """Total loss of a batch and its parts, scalars, divided by the number of positive cells."""

    total: Tensor
    classification: Tensor
    regression: Tensor


class LossSums(NamedTuple):
    """Sums over the cells of one batch or of several, scalars, and how many cells are positive or count."""

    total: Tensor
    classification: Tensor
    regression: Tensor
    positives: Tensor
    cells: Tensor

    def mean(self) -> LossParts:
        """Divide by the positive cells, but at least by a hundredth of the cells.

        Otherwise a batch without lines, divided by one, would weigh as much as one of hundreds of lines.
        """
        count = torch.maximum(self.positives, MIN_POSITIVE_SHARE * self.cells).clamp(min=1e-6)
        return LossParts(self.total / count, self.classification / count, self.regression / count)

    def plus(self, other: LossSums) -> LossSums:
        """Return the sums over the cells of both."""
        return LossSums(*(a + b for a, b in zip(self, other, strict=True)))


@dataclass(frozen=True, slots=True)
class MultiTaskLoss:
    """L = L_cls + weight * [y = 1] L_reg, both summed over cells and divided by the number of positive ones.

    The paper leaves alpha, gamma, w, epsilon and the weight (lambda) open; the defaults train well with
    endpoints in cell fractions.

    Attributes:
        classification: Focal loss, or the full cross-entropy, which alpha and gamma do not affect.
        alpha, gamma: Of the focal loss.
        regression: Wing loss of the summed error d(e, t); or L1, L2 or smooth L1 of each coordinate, summed.
        w, epsilon: Of the Wing loss, in cell fractions.
        beta: Where smooth L1 becomes linear, in cell fractions: by default a pixel of a cell of 32 px. From 1
            it would be L2, since no difference is larger.
        weight: Lambda of the paper.
        any_order: Count the better of both orders of the ends, as d(e, t) does; else from left to right.
        main_grid_only: Leave the other three grids untrained.
    """

    classification: Literal["focal", "cross_entropy"] = "focal"
    alpha: float = 0.5
    gamma: float = 2.0
    regression: Literal["wing", "l1", "l2", "smooth_l1"] = "wing"
    w: float = 1.0
    epsilon: float = 0.1
    beta: float = 1 / 32
    weight: float = 1.0
    any_order: bool = True
    main_grid_only: bool = False

    def __post_init__(self) -> None:
        if self.classification not in {"focal", "cross_entropy"}:
            raise ValueError(f"no classification loss {self.classification!r}; give focal or cross_entropy")
        if self.regression not in {"wing", "l1", "l2", "smooth_l1"}:
            raise ValueError(f"no regression loss {self.regression!r}; give wing, l1, l2 or smooth_l1")
        if not 0 <= self.alpha <= 1 or min(self.w, self.epsilon, self.beta) <= 0:
            raise ValueError("alpha must be from 0 to 1, and w, epsilon and beta positive")
        if self.gamma < 0 or self.weight < 0:
            raise ValueError("gamma and weight must not be negative")

    def __call__(self, output: RawOutput, labels: Tensor, endpoints: Tensor) -> LossParts:
        """Return the losses of a batch; labels (N, R, C) and endpoints (N, R, C, 4) as in `grid.Targets`."""
        return self.sums(output, labels, endpoints).mean()

    def sums(self, output: RawOutput, labels: Tensor, endpoints: Tensor) -> LossSums:
        """Return the sums of the losses of a batch, to be added to those of other batches."""
        if self.main_grid_only:
            labels = of_main_grid(labels, IGNORED)
        logits = output.logits.float().permute(0, 2, 3, 1)[labels != IGNORED]
        is_positive = labels[labels != IGNORED] == POSITIVE
        predicted = output.endpoints.float().permute(0, 2, 3, 1)[labels == POSITIVE]
        classification = self._classification(logits, is_positive).sum()
        regression = self._regression(predicted, endpoints[labels == POSITIVE]).sum()
        return LossSums(
            total=classification + self.weight * regression,
            classification=classification,
            regression=regression,
            positives=is_positive.sum().float(),
            cells=torch.full((), float(len(is_positive)), device=logits.device),
        )

    def _classification(self, logits: Tensor, is_positive: Tensor) -> Tensor:
        if self.classification == "cross_entropy":
            return F.cross_entropy(logits, is_positive.long(), reduction="none")
        return focal_loss(logits, is_positive, self.alpha, self.gamma)

    def _regression(self, predicted: Tensor, target: Tensor) -> Tensor:
        """(N,) losses of (N, 4) endpoints."""
        if not self.any_order:
            return self._in_order(predicted, left_to_right(target))
        return torch.minimum(self._in_order(predicted, target), self._in_order(predicted[:, SWAPPED], target))

    def _in_order(self, predicted: Tensor, target: Tensor) -> Tensor:
        if self.regression == "wing":
            return wing_loss((target - predicted).abs().sum(1), self.w, self.epsilon)
        if self.regression == "smooth_l1":
            return F.smooth_l1_loss(predicted, target, reduction="none", beta=self.beta).sum(1)
        difference = target - predicted
        return difference.abs().sum(1) if self.regression == "l1" else (difference**2).sum(1) / 2


def of_main_grid(values: Tensor, other: float) -> Tensor:
    """Return values (..., R, C) of the interleaved map with those of the three shifted grids replaced."""
    kept = torch.full_like(values, other)
    kept[..., ::2, ::2] = values[..., ::2, ::2]
    return kept
