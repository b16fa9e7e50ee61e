"""Training a tiny network on a handful of drawn lines."""

from __future__ import annotations

import contextlib
import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from nets import TINY

from lsnet import network_config
from lsnet.errors import LSNetError
from lsnet.network_config import LSNetConfig
from lsnet.synth.drawing import Sample
from lsnet.training.batches import load_batches
from lsnet.training.checkpoints import load_checkpoint, save_checkpoint
from lsnet.training.recipe import RECIPES, TrainConfig, TrainingProgress, learning_rate_at
from lsnet.training.sources import export_run
from lsnet.training.tasks import LSNetTask, open_task
from lsnet.training.trainer import Trainer
from lsnet.weights import load_weights

QUICK = TrainConfig(
    preset="tiny",
    steps=12,
    batch_size=2,
    learning_rate=5e-3,
    warmup_steps=2,
    validate_every=4,
    validation_images=2,
    threads=1,
    workers=0,
)


THIN = LSNetConfig(stage_channels=(4, 4, 4, 4), head_channels=4, norm="batch")


class Strokes:
    """A few fixed images, each with one bright line on a dark ground."""

    size = 64

    def __init__(self, count: int = 4, seed: int = 0) -> None:
        self._count, self._seed, self.asked = count, seed, []

    def __getitem__(self, index: int) -> Sample:
        self.asked.append(index)
        rng = np.random.default_rng([self._seed, index % self._count])
        image, line = np.full((64, 64, 3), 40, np.uint8), rng.uniform(0, 64, (2, 2))
        cv2.line(image, *(tuple(p) for p in line.astype(int).tolist()), (220, 220, 220), 3)
        return Sample(image, [line])


@pytest.fixture(autouse=True)
def _tiny_preset(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(network_config.PRESETS, "tiny", TINY)
    monkeypatch.setitem(network_config.PRESETS, "thin", THIN)


@pytest.fixture(scope="module")
def template(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("finished") / "run"
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(network_config.PRESETS, "tiny", TINY)
        Trainer(QUICK, folder).run(Strokes(), Strokes(), quiet)
    return folder


@pytest.fixture
def finished(template: Path, tmp_path: Path) -> Path:
    """The folder of a run that is done."""
    return Path(shutil.copytree(template, tmp_path / "a"))


@pytest.fixture(autouse=True)
def _threads_restored() -> object:
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


def quiet(_progress: TrainingProgress) -> None:
    pass


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


def test_interrupted_run_gives_the_weights_of_an_uninterrupted_one(tmp_path: Path) -> None:
    class Killed(Exception):  # noqa: N818
        pass

    def kill_at_eight(progress: TrainingProgress) -> None:
        if progress.step == 8:
            raise Killed

    Trainer(QUICK, tmp_path / "whole").run(Strokes(), Strokes(), quiet)
    with pytest.raises(Killed):  # after four steps it has kept a checkpoint; the next four are lost
        Trainer(QUICK, tmp_path / "killed").run(Strokes(), Strokes(), kill_at_eight)
    samples = Strokes()
    resumed = Trainer(QUICK, tmp_path / "killed", seed=99)
    assert resumed.step == 4
    resumed.run(samples, Strokes(), quiet)
    assert samples.asked == list(range(8, 24))
    whole, killed = (torch.load(tmp_path / name / "last.pt") for name in ("whole", "killed"))
    for part in ("net", "average"):
        for name, tensor in whole[part].items():
            assert torch.equal(tensor, killed[part][name]), name
    assert (whole["step"], whole["best_loss"]) == (killed["step"], killed["best_loss"])


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
    "change", [{"learning_rate": 1.0}, {"steps": 13}, {"data": "others"}, {"preset": "fast"}]
)
def test_another_recipe_is_refused(finished: Path, change: dict[str, object]) -> None:
    with pytest.raises(LSNetError, match=f"other {next(iter(change))}.*; give another run folder"):
        Trainer(replace(QUICK, **change), finished)
    Trainer(replace(QUICK, threads=2), finished)  # how it is computed may change


def test_run_continues_after_its_preset_changed(
    finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It can be exported, and cannot be continued with another network by mistake."""
    monkeypatch.setitem(network_config.PRESETS, QUICK.preset, replace(TINY, head_channels=16))
    export_run(finished, tmp_path / "x.safetensors", "mine", 0.4, None)
    assert load_weights(tmp_path / "x.safetensors").card.network == TINY
    with pytest.raises(LSNetError, match="other network; give another run folder"):
        Trainer(QUICK, finished)


def test_run_can_start_from_the_weights_of_another(finished: Path, tmp_path: Path) -> None:
    started = Trainer(QUICK, tmp_path / "b", seed=5, start=finished / "best.pt")
    kept = torch.load(finished / "best.pt")["average"]
    assert all(torch.equal(t, kept[name]) for name, t in started.net.state_dict().items())
    assert all(torch.equal(t, kept[name]) for name, t in started.average.state_dict().items())
    assert started.step == 0


def test_run_can_start_from_shipped_weights(tmp_path: Path) -> None:
    started = Trainer(replace(QUICK, preset="fast"), tmp_path, start="fast")
    shipped = load_weights("fast").net.state_dict()
    assert all(torch.equal(t, shipped[name]) for name, t in started.average.state_dict().items())
    with pytest.raises(LSNetError, match="no such weights"):
        Trainer(QUICK, tmp_path / "b", start="slow")


def test_a_resumed_run_has_the_start_it_began_with(finished: Path, tmp_path: Path) -> None:
    Trainer(replace(QUICK, steps=1), tmp_path / "other", seed=3).run(Strokes(), Strokes(), quiet)
    start = finished / "best.pt"
    Trainer(QUICK, tmp_path / "b", start=start).run(Strokes(), Strokes(), quiet)
    assert Trainer(QUICK, tmp_path / "b", start=start).step == 12
    for other in (tmp_path / "other/best.pt", None):
        with pytest.raises(LSNetError, match="holds a run with other start_sha256; give another run folder"):
            Trainer(QUICK, tmp_path / "b", start=other)
    with pytest.raises(LSNetError, match=r"none\.pt: missing or damaged"):
        Trainer(QUICK, tmp_path / "b", start=tmp_path / "none.pt")


def test_a_run_of_an_older_version_continues_with_what_are_the_defaults(finished: Path) -> None:
    last = torch.load(finished / "last.pt")
    for name in ("loss", "off_centre_penalty", "start_sha256", "schedule", "clip_norm", "device"):
        del last["recipe"][name]
    del last["recipe"]["network"]["centred"]
    torch.save(last, finished / "last.pt")
    assert Trainer(QUICK, finished).step == 12
    for task in (open_task("tiny", ["centred=true"]), open_task("tiny", (), ["gamma=1"])):
        with pytest.raises(LSNetError, match=r"holds a run with other (network|loss)"):
            Trainer(QUICK, finished, task=task)


def test_the_loss_is_kept_with_every_checkpoint(tmp_path: Path) -> None:
    task = open_task("tiny", (), ["regression=smooth_l1", "beta=0.1", "any_order=false"], longest=True)
    Trainer(replace(QUICK, steps=1), tmp_path, task=task).run(Strokes(), Strokes(), quiet)
    for name in ("best.pt", "last.pt"):
        recipe = load_checkpoint(tmp_path / name)["recipe"]
        assert (recipe["loss"]["regression"], recipe["loss"]["beta"]) == ("smooth_l1", 0.1)
        assert (recipe["loss"]["any_order"], recipe["off_centre_penalty"]) == (False, 0.0)
    export_run(tmp_path, tmp_path / "x.safetensors", "mine", 0.4, None)
    assert load_weights(tmp_path / "x.safetensors").card.recipe["loss"]["beta"] == 0.1


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


def test_unusable_checkpoints_are_one_line(finished: Path, tmp_path: Path) -> None:
    (tmp_path / "damaged.pt").write_bytes((finished / "best.pt").read_bytes()[:500])
    (tmp_path / "file").touch()
    for start in ("missing.pt", "damaged.pt"):
        with pytest.raises(LSNetError, match=start):
            Trainer(QUICK, tmp_path / "b", start=tmp_path / start)
    with pytest.raises(LSNetError, match=r"best\.pt: not weights of this network or a wider one"):
        Trainer(replace(QUICK, preset="fast"), tmp_path / "b", start=finished / "best.pt")
    (finished / "last.pt").write_bytes(b"PK")
    with pytest.raises(LSNetError, match=r"last\.pt: missing or damaged"):
        Trainer(QUICK, finished)
    with pytest.raises(LSNetError, match="cannot be created as a folder"):
        Trainer(QUICK, tmp_path / "file")


def test_run_with_a_checkpoint_of_another_network_is_one_line(tmp_path: Path) -> None:
    Trainer(replace(QUICK, steps=1), tmp_path).run(Strokes(), Strokes(), quiet)
    last = torch.load(tmp_path / "last.pt")
    for strange in (torch.zeros(3), {"a": 1}, last | {"net": {}}, last | {"optimizer": {}}):
        torch.save(strange, tmp_path / "last.pt")
        with pytest.raises(LSNetError, match=r"last\.pt: (not a checkpoint|damaged or of another version)"):
            Trainer(replace(QUICK, steps=1), tmp_path)


@pytest.mark.parametrize("byte", [0x00, 0x2E, 0x52, 0xC4])
def test_a_checkpoint_with_a_damaged_byte_is_one_line_or_read(tmp_path: Path, byte: int) -> None:
    path = tmp_path / "best.pt"
    save_checkpoint({"average": {"weight": torch.zeros(2)}, "step": 3}, path)
    whole = path.read_bytes()
    for at in range(0, len(whole), 7):
        path.write_bytes(whole[:at] + bytes([byte]) + whole[at + 1 :])
        with contextlib.suppress(LSNetError):
            load_checkpoint(path)


def test_a_checkpoint_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(LSNetError, match=r"best\.pt: cannot be written; free disk space"):
        save_checkpoint({}, tmp_path / "none/best.pt")


def test_diverging_run_is_one_line(tmp_path: Path) -> None:
    trainer = Trainer(replace(QUICK, learning_rate=1e30), tmp_path)
    with pytest.raises(LSNetError, match="the loss is no longer finite; lower the learning rate"):
        trainer.run(Strokes(), Strokes(), quiet)
    assert not (tmp_path / "best.pt").exists()


class Unreadable(Strokes):
    """Samples of a file that is damaged."""

    def __getitem__(self, index: int) -> Sample:
        raise LSNetError("a.png: damaged; remove it")


@pytest.mark.parametrize("workers", [0, 1])
def test_a_sample_that_cannot_be_read_is_one_line(workers: int) -> None:
    with pytest.raises(LSNetError) as error:
        list(load_batches(Unreadable(), range(2), LSNetTask(TINY), batch_size=2, workers=workers))
    assert str(error.value) == "a.png: damaged; remove it"


def test_learning_rate_warms_up_and_cools_down() -> None:
    config = TrainConfig(steps=1000, warmup_steps=100, learning_rate=1.0)
    assert learning_rate_at(0, config) == pytest.approx(0.01)
    assert learning_rate_at(99, config) == pytest.approx(1.0)
    assert learning_rate_at(550, config) == pytest.approx(0.01 + 0.99 / 2)
    assert learning_rate_at(1000, config) == pytest.approx(0.01)
    assert [learning_rate_at(step, RECIPES["paper"]) for step in (0, 9999)] == [1e-4, 1e-4]


def test_export_keeps_the_best_average_with_its_recipe(tmp_path: Path) -> None:
    Trainer(QUICK, tmp_path / "run").run(Strokes(), Strokes(), quiet)
    metrics = tmp_path / "metrics.jsonl"
    metrics.write_text('{"folder": "a"}\n{"folder": "b"}\n')
    sha256 = export_run(tmp_path / "run", tmp_path / "x.safetensors", "mine", 0.4, metrics)
    loaded, best = load_weights(tmp_path / "x.safetensors"), torch.load(tmp_path / "run/best.pt")
    assert all(torch.equal(t, best["average"][name]) for name, t in loaded.net.state_dict().items())
    assert (loaded.sha256, loaded.card.name, loaded.card.min_score) == (sha256, "mine", 0.4)
    assert loaded.card.network == TINY
    assert loaded.card.recipe["trained_steps"] == best["step"]
    assert loaded.card.recipe["learning_rate"] == QUICK.learning_rate
    assert loaded.card.metrics == {"evaluated": [{"folder": "a"}, {"folder": "b"}]}


def test_export_of_a_folder_without_a_run_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(LSNetError, match="train to the first validation"):
        export_run(tmp_path, tmp_path / "x.safetensors", "mine", 0.4, None)
    Trainer(QUICK, tmp_path / "run").run(Strokes(), Strokes(), quiet)
    (tmp_path / "metrics").write_text("no json")
    with pytest.raises(LSNetError, match="not the output of lsnet-pipe model eval --json"):
        export_run(tmp_path / "run", tmp_path / "x.safetensors", "mine", 0.4, tmp_path / "metrics")
    with pytest.raises(LSNetError, match="cannot be written"):
        export_run(tmp_path / "run", tmp_path / "none/x.safetensors", "mine", 0.4, None)
    torch.save({"average": {}, "step": 1}, tmp_path / "run/best.pt")
    with pytest.raises(LSNetError, match=r"run: best\.pt is not of the network of last\.pt"):
        export_run(tmp_path / "run", tmp_path / "x.safetensors", "mine", 0.4, None)


class Blurred(Strokes):
    """Images that need OpenCV's threads, where it has any."""

    def __getitem__(self, index: int) -> Sample:
        cv2.GaussianBlur(np.zeros((500, 500, 3), np.uint8), (0, 0), 3)
        return super().__getitem__(index)


@pytest.mark.timeout(30)
def test_a_worker_draws_images_after_opencv_ran_threads_in_the_training_process() -> None:
    before = cv2.getNumThreads()
    cv2.setNumThreads(2)
    try:
        cv2.GaussianBlur(np.zeros((2000, 2000, 3), np.uint8), (0, 0), 3)
        batches = list(load_batches(Blurred(), range(4), LSNetTask(TINY), batch_size=2, workers=1))
    finally:
        cv2.setNumThreads(before)
    assert [len(images) for images, _, _ in batches] == [2, 2]
