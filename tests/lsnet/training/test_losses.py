"""The losses by hand and by finite differences."""

from __future__ import annotations

import math

import pytest
import torch

from lsnet.model import RawOutput
from lsnet.training.losses import (
    LossSums,
    MultiTaskLoss,
    focal_loss,
    of_main_grid,
    wing_loss,
)

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


def endpoint_error(predicted: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
    """d(e, t) of the paper."""
    return MultiTaskLoss(regression="l1")._regression(predicted, target)


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
ONE_CELL = (torch.tensor([[[1]]], dtype=torch.int8), torch.tensor([[[[0.0, 0.5, 1.0, 0.5]]]]))
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


@pytest.mark.parametrize(
    ("regression", "expected"),
    [
        # Differences of single coordinates: 0.1 of the first segment, swapped, and 2 of the second.
        ("l1", 0.1 + 2),
        ("l2", 0.1**2 / 2 + 2**2 / 2),
        ("smooth_l1", 0.1**2 / (2 * 0.5) + (2 - 0.5 / 2)),  # beta 0.5: below it quadratic, above it linear
    ],
)
def test_regression_losses_are_of_each_coordinate(regression: str, expected: float) -> None:
    result = MultiTaskLoss(regression=regression, beta=0.5)(output(), LABELS, TARGETS)
    assert result.regression.item() == pytest.approx(expected / 2)


def test_losses_of_two_coordinates_are_added() -> None:
    """Two differences of 0.3: L2 of each is half of what L2 of their sum would be."""
    labels, target = torch.tensor([[[1]]], dtype=torch.int8), torch.tensor([[[[0.0, 0.0, 1.0, 1.0]]]])
    said = raw([[0.0, 0.0]], [[0.3, 0.3, 1, 1]])
    assert MultiTaskLoss(regression="l2")(said, labels, target).regression.item() == pytest.approx(0.09)
    assert MultiTaskLoss(regression="l1")(said, labels, target).regression.item() == pytest.approx(0.6)
    smooth = MultiTaskLoss(regression="smooth_l1")(said, labels, target).regression.item()
    assert smooth == pytest.approx(2 * (0.3 - 1 / 64))  # linear from a pixel of a cell of 32


def test_smooth_l1_that_is_linear_from_one_is_l2_in_cell_fractions() -> None:
    smooth, l2 = (
        MultiTaskLoss(regression=name, beta=1.0)(
            raw([[0.0, 0.0]], [[0.2, 0.9, 0.4, 0.1]]), *ONE_CELL
        ).regression
        for name in ("smooth_l1", "l2")
    )
    assert smooth.item() == pytest.approx(l2.item())


def test_ends_in_order_are_from_left_to_right() -> None:
    ordered = MultiTaskLoss(any_order=False, regression="l2")(output(), LABELS, TARGETS)
    assert ordered.regression.item() == pytest.approx((1 + 1 + 1 + 0.9**2 + 2**2) / 2 / 2)


def test_cross_entropy_is_the_full_one() -> None:
    result = MultiTaskLoss(classification="cross_entropy", alpha=0.1)(output(), LABELS, TARGETS)
    expected = -(math.log(1 / 2) + math.log(1 / 2) + math.log(3 / 4))
    assert result.classification.item() == pytest.approx(expected / 2, rel=1e-5)


def test_a_batch_without_lines_weighs_less_than_one_with_many() -> None:
    """400 positive cells of 4,000: their mean; none of 4,000: the sum over 40, not over one."""
    sums = LossSums(*(torch.tensor(value) for value in (80.0, 80.0, 0.0, 400.0, 4000.0)))
    none = sums._replace(positives=torch.tensor(0.0))
    assert sums.mean().total.item() == pytest.approx(80 / 400)
    assert none.mean().total.item() == pytest.approx(80 / 40)


def test_losses_of_several_batches_are_those_of_all_their_cells() -> None:
    loss, said = MultiTaskLoss(), output()
    whole = loss(said, LABELS, TARGETS)
    parts = [
        loss.sums(RawOutput(*(part[..., cut] for part in said)), LABELS[..., cut], TARGETS[:, :, cut])
        for cut in (slice(0, 1), slice(1, 4))
    ]
    torch.testing.assert_close(parts[0].plus(parts[1]).mean(), whole)


@pytest.mark.parametrize(
    "options", [{"regression": "l3"}, {"classification": "hinge"}, {"alpha": 2}, {"w": 0}, {"gamma": -1}]
)
def test_impossible_options_are_refused(options: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=r"loss|must"):
        MultiTaskLoss(**options)


def test_the_main_grid_alone_is_every_second_row_and_column() -> None:
    kept = of_main_grid(torch.ones(3, 5), 0.0)
    assert kept.tolist() == [[1, 0, 1, 0, 1], [0] * 5, [1, 0, 1, 0, 1]]
    said = output()
    MultiTaskLoss(main_grid_only=True)(said, LABELS, TARGETS).total.backward()
    assert said.logits.grad[0, :, 0].abs().sum(0).gt(0).tolist() == [True, False, False, False]
