"""The losses by hand and by finite differences."""

from __future__ import annotations

import math

import pytest
import torch

from lsnet.losses import (
    MultiTaskLoss,
    endpoint_error,
    focal_loss,
    l2_loss,
    of_main_grid,
    ordered_error,
    smooth_l1_loss,
    wing_loss,
)
from lsnet.model import RawOutput

E = torch.tensor([[0.1, 0.2, 0.8, 0.9]], dtype=torch.float64)


def test_focal_loss_by_hand() -> None:
    # Logits whose softmax is (1/4, 3/4): a positive cell has p_t 3/4, a negative one 1/4.
    logits = torch.tensor([[0.0, math.log(3)]] * 2, dtype=torch.float64)
    found = focal_loss(logits, torch.tensor([True, False]), alpha=0.25, gamma=2.0)
    positive = -0.25 * (1 / 4) ** 2 * math.log(3 / 4)
    negative = -0.75 * (3 / 4) ** 2 * math.log(1 / 4)
    torch.testing.assert_close(found, torch.tensor([positive, negative], dtype=torch.float64))


def test_focal_loss_without_focus_is_half_the_cross_entropy() -> None:
    logits, labels = torch.randn(20, 2, dtype=torch.float64), torch.randint(2, (20,))
    found = focal_loss(logits, labels == 1, alpha=0.5, gamma=0.0)
    torch.testing.assert_close(found, torch.nn.functional.cross_entropy(logits, labels, reduction="none") / 2)


def test_focal_loss_is_finite_for_confident_errors() -> None:
    logits = torch.tensor([[200.0, -200.0]], requires_grad=True)
    loss = focal_loss(logits, torch.tensor([True]), 0.5, 2.0).sum()
    loss.backward()
    assert loss.item() == pytest.approx(200)
    assert torch.isfinite(logits.grad).all()


def test_endpoint_error_by_hand() -> None:
    target = torch.tensor([[0.2, 0.2, 0.8, 1.0]], dtype=torch.float64)
    assert endpoint_error(E, target).item() == pytest.approx(0.1 + 0.1)
    assert endpoint_error(E[:, [2, 3, 0, 1]], target).item() == pytest.approx(0.2)
    halfway = torch.tensor([[0.1, 0.9, 0.8, 0.2]], dtype=torch.float64)  # the other diagonal
    assert endpoint_error(E, halfway).item() == pytest.approx(0.7 + 0.7)


def test_endpoint_error_has_no_order() -> None:
    predicted, target = torch.rand(50, 4), torch.rand(50, 4)
    swap = [2, 3, 0, 1]
    expected = endpoint_error(predicted, target)
    torch.testing.assert_close(endpoint_error(predicted[:, swap], target), expected)
    torch.testing.assert_close(endpoint_error(predicted, target[:, swap]), expected)


def test_an_ordered_error_counts_ends_from_left_to_right() -> None:
    target = torch.tensor([[0.8, 1.0, 0.2, 0.2]], dtype=torch.float64)
    assert ordered_error(E, target).item() == pytest.approx(0.1 + 0.1)
    assert ordered_error(E[:, [2, 3, 0, 1]], target).item() == pytest.approx(0.6 + 0.7 + 0.7 + 0.8)


def test_the_other_regression_losses_by_hand() -> None:
    errors = torch.tensor([0.0, 0.5, 1.0, 3.0], dtype=torch.float64)
    assert smooth_l1_loss(errors).tolist() == [0.0, 0.125, 0.5, 2.5]
    assert l2_loss(errors).tolist() == [0.0, 0.125, 0.5, 4.5]


def test_wing_loss_by_hand_and_continuous_at_w() -> None:
    w, epsilon = 1.0, 0.1
    errors = torch.tensor([0.0, 0.1, 1 - 1e-9, 1 + 1e-9, 3.0], dtype=torch.float64)
    found = wing_loss(errors, w, epsilon)
    c = w - w * math.log(1 + w / epsilon)
    expected = [0.0, math.log(2), math.log(11), 1 - c, 3 - c]
    torch.testing.assert_close(found, torch.tensor(expected, dtype=torch.float64), atol=1e-7, rtol=0)
    assert found[3] - found[2] == pytest.approx(0, abs=1e-7)


def test_gradients_are_those_of_finite_differences() -> None:
    torch.manual_seed(0)
    logits = torch.randn(6, 2, dtype=torch.float64, requires_grad=True)
    is_positive = torch.tensor([True, False] * 3)
    assert torch.autograd.gradcheck(lambda x: focal_loss(x, is_positive, 0.25, 2.0), logits)
    errors = torch.tensor([0.05, 0.5, 0.97, 1.03, 4.0], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda x: wing_loss(x, 1.0, 0.1), errors)
    predicted = torch.rand(6, 4, dtype=torch.float64, requires_grad=True)
    target = torch.rand(6, 4, dtype=torch.float64)
    assert torch.autograd.gradcheck(lambda x: endpoint_error(x, target), predicted)


def raw(logits: list[list[float]], endpoints: list[list[float]]) -> RawOutput:
    """An output of one image with a map of one row."""
    return RawOutput(
        torch.tensor(logits).T[None, :, None].requires_grad_(),
        torch.tensor(endpoints).T[None, :, None].requires_grad_(),
    )


LABELS = torch.tensor([[[1, 0, -1, 1]]], dtype=torch.int8)
TARGETS = torch.tensor([[[[0, 0, 1, 1], [0] * 4, [0] * 4, [0.5, 0, 0.5, 1]]]])


def output() -> RawOutput:
    return raw(
        [[0, 0], [0, 0], [3, 9], [0, math.log(3)]],
        [[1, 1, 0, 0.1], [7, 7, 7, 7], [7, 7, 7, 7], [0.5, 0, 0.5, 3]],
    )


def test_multi_task_loss_by_hand() -> None:
    losses = MultiTaskLoss(alpha=0.25, gamma=1.0, w=1.0, epsilon=0.1, weight=2.0)(output(), LABELS, TARGETS)
    half = math.log(2) / 2  # (1 - 1/2) * -log(1/2)
    cells = (0.25 * half + 0.75 * half + 0.25 * 0.25 * -math.log(0.75)) / 2
    wing = math.log(1 + 0.1 / 0.1) + (2 - (1 - math.log(11)))  # errors 0.1, swapped, and 2
    assert losses.classification.item() == pytest.approx(cells, rel=1e-5)
    assert losses.regression.item() == pytest.approx(wing / 2, rel=1e-5)
    assert losses.total.item() == pytest.approx(cells + 2 * wing / 2, rel=1e-5)


def test_ignored_and_empty_cells_affect_only_their_part_of_the_loss() -> None:
    said = output()
    MultiTaskLoss()(said, LABELS, TARGETS).total.backward()
    logits, endpoints = said.logits.grad[0, :, 0], said.endpoints.grad[0, :, 0]
    assert logits.abs().sum(0).gt(0).tolist() == [True, True, False, True]
    assert endpoints.abs().sum(0).gt(0).tolist() == [True, False, False, True]


def test_an_image_without_lines_has_a_loss_and_no_regression() -> None:
    said = output()
    losses = MultiTaskLoss()(said, torch.zeros_like(LABELS), torch.zeros_like(TARGETS))
    losses.total.backward()
    assert losses.regression.item() == 0
    assert losses.classification.item() > 0
    assert torch.isfinite(said.logits.grad).all()


def test_other_losses_are_the_parts_asked_for() -> None:
    result = MultiTaskLoss(error=ordered_error, regression="l2")(output(), LABELS, TARGETS)
    assert result.regression.item() == pytest.approx(
        (3.9**2 + 2**2) / 2 / 2
    )  # ends 1 1 0 0.1 are not swapped
    smooth = MultiTaskLoss(regression="smooth_l1")(output(), LABELS, TARGETS)
    assert smooth.regression.item() == pytest.approx((0.1**2 / 2 + 1.5) / 2)


def test_the_main_grid_alone_is_every_second_row_and_column() -> None:
    kept = of_main_grid(torch.ones(3, 5), 0.0)
    assert kept.tolist() == [[1, 0, 1, 0, 1], [0] * 5, [1, 0, 1, 0, 1]]
    said = output()
    MultiTaskLoss(main_grid_only=True)(said, LABELS, TARGETS).total.backward()
    assert said.logits.grad[0, :, 0].abs().sum(0).gt(0).tolist() == [True, False, False, False]
