"""`lsnet-pipe model train|export|convert|synth|lines`, on tiny networks and few images."""

from __future__ import annotations

import hashlib
import json
from typing import TYPE_CHECKING

import numpy as np
import pytest
from evaluation_sets import write_masks
from model_commands import photos, run, validate_on_few_images
from nets import openvino_or_skip
from safetensors.numpy import load_file
from typer.testing import CliRunner

import cli
from lsnet import LSNetError, load_weights
from lsnet.pretrained import path_of
from lsnet.training import checkpoints

if TYPE_CHECKING:
    from pathlib import Path


def test_lines_trains_a_score_that_detection_uses(tmp_path: Path) -> None:
    openvino_or_skip()
    folder = photos(tmp_path / "photos", 12)
    result = run("lines", "--background", folder, "--scenes", 40, "-o", "new.safetensors")
    assert (result.exit_code, result.stderr) == (0, "")
    validation, written = result.stdout.splitlines()
    assert validation.startswith("validation: F 0.")
    assert hashlib.sha256((tmp_path / "new.safetensors").read_bytes()).hexdigest() in written
    new, old = (load_file(file) for file in ("new.safetensors", path_of("fast")))
    assert set(new) == set(old)
    assert not np.array_equal(new["line_score.0.weight"], old["line_score.0.weight"])
    assert all(np.array_equal(new[name], old[name]) for name in old if not name.startswith("line_score."))


def test_lines_can_keep_the_networks_of_a_score(tmp_path: Path) -> None:
    openvino_or_skip()
    folder = photos(tmp_path / "photos", 12)
    result = run("lines", "--context-only", "--background", folder, "--scenes", 20, "-o", "new.safetensors")
    assert (result.exit_code, result.stderr) == (0, "")
    new, old = (load_file(file) for file in ("new.safetensors", path_of("fast")))
    changed = {name for name in old if not np.array_equal(new[name], old[name])}
    assert "line_score.context.0.weight" in changed
    assert all(name.startswith("line_score.context.") for name in changed)
    result = run("lines", "--context-only", "--weights", "w.safetensors", "-o", "new.safetensors")
    assert "w.safetensors: has no line score whose networks could be kept" in str(result.exception)


def test_lines_needs_proposals_to_train_on() -> None:
    result = run("lines", "--scenes", 1, "--weights", "w.safetensors", "-o", "new.safetensors")
    assert result.exit_code != 0
    assert "too few proposals in 1 scenes to train on; draw more scenes" in str(result.exception)


def test_train_and_export_and_detect(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    validate_on_few_images(monkeypatch)
    photos(tmp_path / "photos")
    words = ("--run", "run", "--background", "photos:1", "--preset", "tiny", "--crop", 64)
    steps = ("--steps", 4, "--batch-size", 2, "--validate-every", 2, "--workers", 0)
    result = run("train", *words, *steps)
    assert (result.exit_code, result.stderr) == (0, "")
    assert result.stdout.startswith("run/best.pt: validation loss ")
    assert [json.loads(line)["step"] for line in (tmp_path / "run/log.jsonl").read_text().splitlines()] == [
        2,
        4,
    ]
    assert run("train", *words, *steps).stdout == result.stdout  # nothing left to do
    other = run("train", *words, *steps, "--learning-rate", 0.5)
    assert "give another run folder" in str(other.exception)
    exported = run("export", "--run", "run", "-o", "mine.safetensors", "--name", "mine", "--min-score", 0.3)
    loaded = load_weights("mine.safetensors")
    assert exported.stdout == f"mine.safetensors: mine, sha256 {loaded.sha256}\n"
    assert loaded.card.recipe["data"] == "drawn on photos, first 1, 64 px, seed 0"
    found = CliRunner().invoke(
        cli.app, ["detect", "photos/0.png", "--json", "--weights", "mine.safetensors", "--runtime", "torch"]
    )
    assert json.loads(found.stdout)["path"] == "photos/0.png"


def test_train_by_the_recipe_of_the_paper(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    validate_on_few_images(monkeypatch)
    words = ("--run", "run", "--background", photos(tmp_path / "photos"), "--preset", "tiny", "--crop", 64)
    steps = ("--steps", 1, "--batch-size", 2, "--validate-every", 1, "--workers", 0, "--device", "cpu")
    result = run("train", "--recipe", "paper", "--loss", "weight=3", *words, *steps)
    assert (result.exit_code, result.stderr) == (0, "")
    kept = checkpoints.load_checkpoint(tmp_path / "run/best.pt")["recipe"]
    assert (kept["learning_rate"], kept["schedule"], kept["clip_norm"]) == (1e-4, "constant", None)
    assert (kept["loss"]["weight"], kept["off_centre_penalty"]) == (3.0, 0.0)
    assert kept["data"].endswith("last tenth held out, augmentations of the paper")


def test_train_and_evaluate_a_rival(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    validate_on_few_images(monkeypatch)
    write_masks(tmp_path / "m")
    network = ("--preset", "wd-dcnn-gnfl", "--network", "channels=4", "--network", "dilations=1,2")
    steps = ("--steps", 2, "--batch-size", 1, "--validate-every", 2, "--crop", 64, "--workers", 0)
    result = run("train", "--run", "rival", *network, *steps, "--device", "cpu")
    assert (result.exit_code, result.stderr) == (0, "")
    (row,) = run("eval", "m", "--paper", "--rival", "rival", "--json").stdout.splitlines()
    assert (json.loads(row)["width_px"], json.loads(row)["binarised"]) == (None, "otsu")
    plain = photos(tmp_path / "plain")
    for words in ((plain,), ("m", "--synthetic", 1)):
        assert "needs folders with masks" in str(run("eval", *words, "--rival", "rival").exception)
    assert "no rival 'rivals'; give lsd, hough" in str(run("eval", "m", "--rival", "rivals").exception)


def test_synth_and_train_on_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("mitsuba")
    validate_on_few_images(monkeypatch)
    made = run("synth", "-o", "renders", "--count", 1, "--size", 64)
    assert made.stdout == "renders: 1 pictures; next: lsnet-pipe model train --rendered renders\n"
    words = ("--run", "run", "--rendered", "renders", "--preset", "tiny", "--crop", 64, "--workers", 0)
    trained = run("train", *words, "--steps", 1, "--batch-size", 2, "--validate-every", 1)
    assert (trained.exit_code, trained.stderr) == (0, "")
    kept = checkpoints.load_checkpoint(tmp_path / "run/last.pt")["recipe"]
    assert kept["data"] == "renders over plain grounds, 64 px, seed 0, last tenth held out"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--preset", "huge"), "no preset 'huge'; choose one of"),
        (("--crop", 100), "multiple of 16"),
        (("--background", "none:4"), "none: not a folder"),
        (("--data", "none"), "labelled images need other ones for validation"),
        (("--data", "none", "--validation", "none"), "none: not a folder"),
        (("--start", "none.pt"), "none.pt: missing or damaged"),
        (("--loss", "delta=1"), "no option 'delta=1'; give NAME=VALUE with one of classification"),
        (("--network", "norm=layer"), "option 'norm=layer' cannot be used: unknown norm"),
    ],
    ids=lambda value: " ".join(map(str, value)) if isinstance(value, tuple) else "",
)
def test_unusable_training_options_are_one_line(arguments: tuple[object, ...], message: str) -> None:
    result = run("train", "--run", "run", "--workers", 0, *arguments)
    assert isinstance(result.exception, LSNetError)
    assert message in str(result.exception)
    assert "\n" not in str(result.exception)


def test_export_of_no_run_is_one_line(tmp_path: Path) -> None:
    result = run("export", "--run", "none", "-o", "x.safetensors", "--name", "x")
    assert isinstance(result.exception, LSNetError)
    assert not (tmp_path / "x.safetensors").exists()


def test_converted_weights_are_kept_beside_them(monkeypatch: pytest.MonkeyPatch) -> None:
    openvino_or_skip()
    monkeypatch.setattr("lsnet.runtime.networks.PRECISIONS", ("f32",))
    result = run("convert", "w.safetensors")
    assert (result.exit_code, result.stdout) == (0, "w.openvino.zip: 0.0 MiB\n")
    assert run("bench", "--size", 64, "--seconds", 0.1, "--weights", "w.safetensors").exit_code == 0
