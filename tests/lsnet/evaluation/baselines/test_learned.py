"""The learned rivals: their layers, targets, losses and maps."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
import torch
from torch import nn

from lsnet.errors import LSNetError
from lsnet.evaluation.baselines.learned import RIVALS, LearnedRival, open_any_task, rival_task
from lsnet.evaluation.baselines.wd_dcnn import WDDCNN, WDDCNNConfig, WDDCNNTask, class_balanced, drawn_lines
from lsnet.evaluation.baselines.wsl_cnn import WSLCNN, WSLCNNConfig, WSLCNNTask
from lsnet.synth.drawing import Sample
from lsnet.training.checkpoints import save_checkpoint
from lsnet.training.sources import export_run
from lsnet.training.tasks import LSNetTask

if TYPE_CHECKING:
    from pathlib import Path

    from torch import Tensor

THIN = WSLCNNConfig(channels=(2, 2, 2, 2, 2))
WHITE_WITH_LINE = Sample(np.full((128, 160, 3), 255, np.uint8), [np.array([[0.0, 64.5], [30.0, 64.5]])])


def test_variants_differ_in_two_switches() -> None:
    for name, config in RIVALS.items():
        if name == "wsl-cnn":
            continue
        net = rival_task(replace(config, channels=2)).build()
        convolutions = [m for m in net if isinstance(m, nn.Conv2d)]
        assert [c.dilation[0] for c in convolutions] == [1, 1, 2, 4, 8, 16, 1, 1]
        assert sum(isinstance(m, nn.GroupNorm) for m in net) == (7 if "-gn" in name else 0)
        assert config.focal == ("fl" in name)


def test_wd_dcnn_keeps_the_size_and_scores_every_pixel() -> None:
    net = WDDCNN(WDDCNNConfig(channels=2, dilations=(1, 16)))
    assert net(torch.zeros(2, 3, 37, 50)).shape == (2, 2, 37, 50)
    scores = LearnedRival(net).confidence(np.zeros((37, 50, 3), np.uint8))
    assert scores.shape == (37, 50)
    assert ((scores > 0) & (scores < 1)).all()


def test_class_balanced_loss_by_hand() -> None:
    """One wire in four pixels, all undecided: 3/4 for the wire, 1/4 for each other, times log 2."""
    losses = class_balanced(torch.zeros(4, 2), torch.tensor([True, False, False, False]))
    assert losses.tolist() == pytest.approx([0.75 * math.log(2), *[0.25 * math.log(2)] * 3])


def test_pixels_are_the_drawn_lines() -> None:
    (mask,) = WDDCNNTask().encode(WHITE_WITH_LINE)
    assert mask.shape == (128, 160)
    assert mask[:, 10].nonzero().flatten().tolist() == [63, 64, 65]
    assert not drawn_lines([], (5, 5), 3).any()
    output = torch.zeros(1, 2, 128, 160)
    for focal in (False, True):
        sums = WDDCNNTask(WDDCNNConfig(focal=focal)).sums(output, mask[None])
        share = float(mask.float().mean())
        expected = 2 * share * (1 - share) if not focal else 0.5 * 0.25
        assert float(sums.mean().total) == pytest.approx(expected * math.log(2), rel=1e-4)


@pytest.mark.parametrize("name", ["wd-dcnn", "wd-dcnn-gnfl"])
def test_wd_dcnn_starts_at_the_prior_and_learns_a_small_set(name: str) -> None:
    """The loss falls far below the least that any constant gives, so pixels are told apart."""
    torch.manual_seed(0)
    task = WDDCNNTask(replace(RIVALS[name], channels=8, dilations=(1, 1, 2, 1)))
    net = task.build()
    rng = np.random.default_rng(0)
    images = torch.from_numpy(rng.normal(120, 12, (2, 3, 32, 48)).astype(np.float32)) / 255
    mask = torch.zeros(2, 32, 48, dtype=torch.bool)
    mask[0, 9:12], mask[1, 20:23] = True, True
    images.permute(1, 0, 2, 3)[:, mask] -= 0.12
    with torch.no_grad():
        scores = net(images).softmax(dim=1)[:, 1]
    assert scores.numpy() == pytest.approx(1 / (1 + math.exp(2.0 if "fl" in name else 0.0)), abs=0.05)

    def loss(logits: Tensor) -> Tensor:
        return task.sums(logits, mask).mean().total

    level = torch.zeros(2, 2, 32, 48)
    levels = [float(loss(level + torch.tensor([0.0, v])[:, None, None])) for v in np.linspace(-5, 2, 50)]
    optimizer = torch.optim.AdamW(net.parameters(), lr=3e-3)
    for _ in range(60):
        optimizer.zero_grad()
        total = loss(net(images))
        total.backward()
        optimizer.step()
    assert float(total.detach()) < 0.25 * min(levels)


def test_windows_have_a_line_or_not() -> None:
    (has_line,) = WSLCNNTask().encode(WHITE_WITH_LINE)
    assert has_line.tolist() == [[True, False]]  # 30 px of line in the first, none from x = 32 on
    assert WSLCNN(THIN)(torch.zeros(1, 3, 128, 256)).shape == (1, 2, 1, 5)
    sums = WSLCNNTask(THIN).sums(torch.zeros(1, 2, 1, 2), has_line[None])
    assert float(sums.mean().total) == pytest.approx(math.log(2))


@pytest.mark.parametrize("size", [(50, 60), (130, 200)])
def test_windows_without_a_line_are_empty_in_the_map(size: tuple[int, int]) -> None:
    net = WSLCNN(replace(THIN, channels=(16,) * 5))
    image = np.random.default_rng(0).integers(0, 256, (*size, 3), np.uint8)
    final = net.head[-1]
    for bias, is_found in (([9.0, -9.0], False), ([-9.0, 9.0], True)):
        with torch.no_grad():
            final.weight.zero_()
            final.bias.copy_(torch.tensor(bias))
        scores = LearnedRival(net).confidence(image)
        assert scores.shape == size
        assert scores.any() == is_found
        assert scores.max() <= 1


def test_a_run_is_loaded_with_its_options(tmp_path: Path) -> None:
    task = open_any_task("wd-dcnn-gn", ["channels=4", "dilations=1,2"])
    net = task.build()
    save_checkpoint({"average": net.state_dict(), "step": 1, "recipe": task.describe()}, tmp_path / "best.pt")
    image = np.random.default_rng(1).integers(0, 256, (20, 30, 3), np.uint8)
    found = LearnedRival.load(tmp_path).confidence(image)
    np.testing.assert_array_equal(found, LearnedRival(net).confidence(image))
    save_checkpoint({"average": {}, "step": 1, "recipe": LSNetTask().describe()}, tmp_path / "best.pt")
    with pytest.raises(LSNetError, match="not a run of a rival; give one trained as wsl-cnn"):
        LearnedRival.load(tmp_path)


def test_a_run_of_a_rival_is_not_exported(tmp_path: Path) -> None:
    state = {"average": {}, "step": 1, "recipe": WDDCNNTask().describe()}
    save_checkpoint(state, tmp_path / "best.pt")
    save_checkpoint(
        state | {"net": {}, "optimizer": {}, "best_loss": 0.0, "bad_validations": 0}, tmp_path / "last.pt"
    )
    with pytest.raises(LSNetError, match="a run of a rival; score it with lsnet-pipe model eval --rival"):
        export_run(tmp_path, tmp_path / "x.safetensors", "x", 0.5, None)


def test_unusable_presets_are_one_line() -> None:
    with pytest.raises(LSNetError, match=r"no preset 'huge'; choose one of paper, fast, .*wsl-cnn"):
        open_any_task("huge")
    with pytest.raises(LSNetError, match="the loss of wd-dcnn is part of its network"):
        open_any_task("wd-dcnn", (), ["gamma=1"])
