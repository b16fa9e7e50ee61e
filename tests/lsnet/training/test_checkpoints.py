"""What checkpoints keep, and the weights that are exported from them."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest
import torch
from nets import TINY
from training_runs import QUICK, Strokes, quiet

from lsnet.errors import LSNetError
from lsnet.training.checkpoints import load_checkpoint, save_checkpoint
from lsnet.training.sources import export_run
from lsnet.training.tasks import open_task
from lsnet.training.trainer import Trainer
from lsnet.weights import load_weights

if TYPE_CHECKING:
    from pathlib import Path


def test_the_loss_is_kept_with_every_checkpoint(tmp_path: Path) -> None:
    task = open_task("tiny", (), ["regression=smooth_l1", "beta=0.1", "any_order=false"], longest=True)
    Trainer(replace(QUICK, steps=1), tmp_path, task=task).run(Strokes(), Strokes(), quiet)
    for name in ("best.pt", "last.pt"):
        recipe = load_checkpoint(tmp_path / name)["recipe"]
        assert (recipe["loss"]["regression"], recipe["loss"]["beta"]) == ("smooth_l1", 0.1)
        assert (recipe["loss"]["any_order"], recipe["off_centre_penalty"]) == (False, 0.0)
    export_run(tmp_path, tmp_path / "x.safetensors", "mine", 0.4, None)
    assert load_weights(tmp_path / "x.safetensors").card.recipe["loss"]["beta"] == 0.1


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
