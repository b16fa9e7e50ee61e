"""Runs that continue, or start from the weights of others."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest
import torch
from nets import TINY
from training_runs import QUICK, Strokes, quiet

from lsnet import network_config
from lsnet.errors import LSNetError
from lsnet.training.sources import export_run
from lsnet.training.tasks import open_task
from lsnet.training.trainer import Trainer
from lsnet.weights import load_weights

if TYPE_CHECKING:
    from pathlib import Path

    from lsnet.training.recipe import TrainingProgress


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


def test_run_with_a_checkpoint_of_another_network_is_one_line(tmp_path: Path) -> None:
    Trainer(replace(QUICK, steps=1), tmp_path).run(Strokes(), Strokes(), quiet)
    last = torch.load(tmp_path / "last.pt")
    for strange in (torch.zeros(3), {"a": 1}, last | {"net": {}}, last | {"optimizer": {}}):
        torch.save(strange, tmp_path / "last.pt")
        with pytest.raises(LSNetError, match=r"last\.pt: (not a checkpoint|damaged or of another version)"):
            Trainer(replace(QUICK, steps=1), tmp_path)


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
