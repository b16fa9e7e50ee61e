"""The multi-task loss of the paper (Section III-C): focal for the cells, Wing for the endpoints."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, NamedTuple

import torch
import torch.nn.functional as F

from lsnet.grid import IGNORED, POSITIVE

if TYPE_CHECKING:
    from collections.abc import Callable

    from torch import Tensor

    from lsnet.model import RawOutput


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


def endpoint_error(predicted: Tensor, target: Tensor) -> Tensor:
    """Return d(e, t): (N,) sums of absolute differences of (N, 4) endpoints, in the better of both orders."""
    swapped = predicted[:, [2, 3, 0, 1]]
    return torch.minimum((target - predicted).abs().sum(1), (target - swapped).abs().sum(1))


def ordered_error(predicted: Tensor, target: Tensor) -> Tensor:
    """Return (N,) sums of absolute differences of (N, 4) endpoints, with targets ordered from left to right.

    The alternative to `endpoint_error` in the ablation.
    """
    swapped = target[:, [2, 3, 0, 1]]
    is_ordered = (target[:, 0] <= target[:, 2])[:, None]
    return (torch.where(is_ordered, target, swapped) - predicted).abs().sum(1)


def smooth_l1_loss(error: Tensor) -> Tensor:
    """Return d^2 / 2 below 1, linear above, elementwise on errors d >= 0 (Girshick)."""
    return torch.where(error < 1, error**2 / 2, error - 0.5)


def l2_loss(error: Tensor) -> Tensor:
    """Return d^2 / 2, elementwise on errors d >= 0."""
    return error**2 / 2


def wing_loss(error: Tensor, w: float, epsilon: float) -> Tensor:
    """Return the Wing loss, logarithmic below w, linear above, elementwise on errors d >= 0 (Feng et al.)."""
    offset = w - w * math.log(1 + w / epsilon)
    return torch.where(error < w, w * torch.log1p(error / epsilon), error - offset)


class LossParts(NamedTuple):
    """Total loss of a batch and its parts, scalars, divided by the number of positive cells."""

    total: Tensor
    classification: Tensor
    regression: Tensor


@dataclass(frozen=True, slots=True)
class MultiTaskLoss:
    """L = L_cls + weight * [y = 1] L_reg, both summed over cells and divided by the number of positive ones.

    The paper leaves alpha, gamma, w, epsilon and the weight (lambda) open; the defaults train well with
    endpoints in cell fractions.
    """

    alpha: float = 0.5
    gamma: float = 2.0
    w: float = 1.0
    epsilon: float = 0.1
    weight: float = 1.0
    error: Callable[[Tensor, Tensor], Tensor] = endpoint_error
    regression: Literal["wing", "smooth_l1", "l2"] = "wing"
    main_grid_only: bool = False  # leave the other three grids untrained

    def __call__(self, output: RawOutput, labels: Tensor, endpoints: Tensor) -> LossParts:
        """Return the losses of a batch; labels (N, R, C) and endpoints (N, R, C, 4) as in `grid.Targets`."""
        if self.main_grid_only:
            labels = of_main_grid(labels, IGNORED)
        logits = output.logits.float().permute(0, 2, 3, 1)[labels != IGNORED]
        is_positive = labels[labels != IGNORED] == POSITIVE
        n_positive = is_positive.sum().clamp(min=1)
        predicted = output.endpoints.float().permute(0, 2, 3, 1)[labels == POSITIVE]
        error = self.error(predicted, endpoints[labels == POSITIVE])
        classification = focal_loss(logits, is_positive, self.alpha, self.gamma).sum() / n_positive
        regression = self._regression(error).sum() / n_positive
        return LossParts(classification + self.weight * regression, classification, regression)

    def _regression(self, error: Tensor) -> Tensor:
        if self.regression == "smooth_l1":
            return smooth_l1_loss(error)
        return l2_loss(error) if self.regression == "l2" else wing_loss(error, self.w, self.epsilon)


def of_main_grid(values: Tensor, other: float) -> Tensor:
    """Return values (..., R, C) of the interleaved map with those of the three shifted grids replaced."""
    kept = torch.full_like(values, other)
    kept[..., ::2, ::2] = values[..., ::2, ::2]
    return kept
