"""Training a tiny network on a handful of drawn lines."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
import torch
from training_runs import QUICK, Strokes, quiet

from lsnet.errors import LSNetError
from lsnet.training.recipe import RECIPES, TrainConfig, TrainingProgress, learning_rate_at
from lsnet.training.tasks import open_task
from lsnet.training.trainer import Trainer

if TYPE_CHECKING:
    from pathlib import Path


def test_training_overfits_a_tiny_set(tmp_path: Path) -> None:
    config = replace(QUICK, steps=100, batch_size=4, validate_every=50, learning_rate=2e-2)
    reports: list[TrainingProgress] = []
    trainer = Trainer(config, tmp_path / "run")
    before = float(trainer.validate(list(trainer.batches(Strokes(), range(4)))).total)
    trainer.run(Strokes(), Strokes(), reports.append)
    found = [r for r in reports if r.validation_loss is not None]
    assert [r.step for r in found] == [50, 100]
    assert trainer.best_loss < before / 2
    assert found[-1].loss < before / 4
    assert found[-1].classification < 0.02
    assert found[-1].loss == pytest.approx(found[-1].classification + found[-1].regression, rel=1e-5)
    log = [json.loads(line) for line in (tmp_path / "run/log.jsonl").read_text().splitlines()]
    assert [entry["validation_loss"] for entry in log] == [r.validation_loss for r in found]
    for entry in log:  # the parts, for curves of the focal and the Wing loss
        parts = entry["validation_classification"] + entry["validation_regression"]
        assert entry["validation_loss"] == pytest.approx(parts, rel=1e-5)


def test_seed_determines_the_run(tmp_path: Path) -> None:
    nets = [Trainer(QUICK, tmp_path / str(i), seed=seed).net for i, seed in enumerate((1, 1, 2))]
    same, other = (
        all(torch.equal(a, b) for a, b in zip(nets[0].parameters(), net.parameters(), strict=True))
        for net in nets[1:]
    )
    assert (same, other) == (True, False)


def test_validation_runs_at_its_interval_and_at_the_end(tmp_path: Path) -> None:
    config, steps = replace(QUICK, steps=7, validate_every=3), []
    trainer = Trainer(config, tmp_path)
    trainer.run(Strokes(), Strokes(), lambda p: steps.append((p.step, p.validation_loss is not None)))
    assert steps == [(3, True), (6, True), (7, True)]


def test_a_run_stops_when_validation_does_not_improve_and_stays_stopped(tmp_path: Path) -> None:
    config, losses = (
        replace(QUICK, steps=40, validate_every=1, patience=3),
        iter([2.0, 1.0, 1.5, 1.0, 3.0, 0.0]),
    )
    trainer = Trainer(config, tmp_path)
    trainer.validate = lambda _batches: (next(losses), 0.0, 0.0)
    trainer.run(Strokes(), Strokes(), quiet)
    assert (trainer.step, trainer.best_loss) == (5, 1.0)
    assert torch.load(tmp_path / "best.pt")["step"] == 2
    again, samples = Trainer(config, tmp_path), Strokes()
    again.run(samples, samples, quiet)
    assert (again.step, samples.asked) == (5, [])


def test_the_averaged_weights_are_kept(tmp_path: Path) -> None:
    trainer = Trainer(QUICK, tmp_path)
    trainer.run(Strokes(), Strokes(), quiet)
    kept, last = torch.load(tmp_path / "best.pt"), torch.load(tmp_path / "last.pt")
    key = "classifier.1.weight"
    assert not torch.equal(last["average"][key], last["net"][key])
    assert set(kept) == {"average", "step", "recipe"}
    assert kept["recipe"] == last["recipe"]


@pytest.mark.parametrize(
    ("network", "loss"),
    [
        (["downsample=pool"], []),
        ([], ["classification=cross_entropy"]),
        *(([], [f"regression={name}"]) for name in ("l1", "l2", "smooth_l1")),
    ],
)
def test_every_variant_of_the_ablation_trains(tmp_path: Path, network: list[str], loss: list[str]) -> None:
    task = open_task("thin", network, loss)
    trainer = Trainer(replace(QUICK, preset="thin", steps=2, validate_every=2), tmp_path, task=task)
    before = {name: tensor.clone() for name, tensor in trainer.net.state_dict().items()}
    trainer.run(Strokes(), Strokes(), quiet)
    assert np.isfinite(trainer.best_loss)
    for name in ("extractor.0.0.weight", "classifier.1.weight", "regressor.1.weight"):
        assert not torch.equal(before[name], trainer.net.state_dict()[name])


def test_the_recipe_of_the_paper_neither_averages_nor_decays(tmp_path: Path) -> None:
    config = replace(RECIPES["paper"], preset="tiny", steps=2, batch_size=2, validate_every=2)
    trainer = Trainer(replace(config, validation_images=2, workers=0), tmp_path)
    trainer.run(Strokes(), Strokes(), quiet)
    group = trainer.optimizer.param_groups[0]
    assert (group["lr"], group["betas"], group["weight_decay"]) == (1e-4, (0.9, 0.999), 0.0)
    for name, tensor in trainer.net.state_dict().items():
        assert torch.equal(tensor, trainer.average.state_dict()[name])


def test_diverging_run_is_one_line(tmp_path: Path) -> None:
    trainer = Trainer(replace(QUICK, learning_rate=1e30), tmp_path)
    with pytest.raises(LSNetError, match="the loss is no longer finite; lower the learning rate"):
        trainer.run(Strokes(), Strokes(), quiet)
    assert not (tmp_path / "best.pt").exists()


def test_learning_rate_warms_up_and_cools_down() -> None:
    config = TrainConfig(steps=1000, warmup_steps=100, learning_rate=1.0)
    assert learning_rate_at(0, config) == pytest.approx(0.01)
    assert learning_rate_at(99, config) == pytest.approx(1.0)
    assert learning_rate_at(550, config) == pytest.approx(0.01 + 0.99 / 2)
    assert learning_rate_at(1000, config) == pytest.approx(0.01)
    assert [learning_rate_at(step, RECIPES["paper"]) for step in (0, 9999)] == [1e-4, 1e-4]
