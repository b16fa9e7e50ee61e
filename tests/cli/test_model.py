"""`lsnet-pipe model bench|eval|export|train`, on tiny networks and few images."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest
import torch
from evaluation_sets import write_masks
from nets import TINY, openvino_or_skip, save_tiny
from safetensors.numpy import load_file
from typer.testing import CliRunner

import cli
from lsnet import LSNetError, load_weights, network_config
from lsnet.evaluation.compare import compare, trainings
from lsnet.pretrained import path_of
from lsnet.training import checkpoints, recipe

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from click.testing import Result


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    threads = torch.get_num_threads()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(network_config.PRESETS, "tiny", TINY)
    save_tiny(tmp_path / "w.safetensors", min_score=0.4)
    yield
    torch.set_num_threads(threads)


def run(*arguments: object) -> Result:
    return CliRunner().invoke(cli.app, ["model", *(str(word) for word in arguments)])


def photos(folder: Path, count: int = 2) -> Path:
    folder.mkdir()
    for i in range(count):
        image = np.random.default_rng(i).integers(0, 256, (70, 100, 3), dtype=np.uint8)
        cv2.imwrite(str(folder / f"{i}.png"), image)
    return folder


TINY_RUN = ("--runtime", "torch", "--weights", "w.safetensors")


def test_bench_reports_what_was_measured(tmp_path: Path) -> None:
    folder = photos(tmp_path / "photos")
    for arguments in ((), ("--images", folder)):
        result = run("bench", "--json", "--size", 32, "--seconds", 0.1, *arguments, *TINY_RUN)
        assert (result.exit_code, result.stderr) == (0, "")
        rows = json.loads(result.stdout)
        assert set(rows) == {"frames_per_s", "backend", "precision", "threads", "preset", "size"}
        assert rows["frames_per_s"] > 0
        assert (rows["backend"], rows["precision"], rows["preset"], rows["size"]) == (
            *("torch", "f32", "fast"),
            32,
        )
        assert rows["threads"] >= 1


def test_bench_without_json_is_a_sentence() -> None:
    result = run("bench", "--size", 32, "--seconds", 0.1, *TINY_RUN)
    assert "frames/s at 32x32: preset fast, torch f32" in result.stdout


def test_eval_of_sets_with_and_without_truth(tmp_path: Path) -> None:
    with_masks, plain = write_masks(tmp_path / "m"), photos(tmp_path / "plain")
    result = run("eval", "m", "plain", "--json", *TINY_RUN)
    assert (result.exit_code, result.stderr) == (0, "")
    *pixel, share = [json.loads(line) for line in result.stdout.splitlines()]
    assert [report["tolerance_px"] for report in pixel] == [1.0, 3.0, 4.87]
    for report in pixel:
        assert (report["folder"], report["images"]) == (with_masks.name, 1)
        assert set(report["ods"]) == {"threshold", "precision", "recall", "f1", "mean_f1"}
        assert report["at_min_score"]["threshold"] == 0.4
    assert (share["folder"], share["images"]) == (plain.name, 2)
    assert share["reported"]["0.3"] >= share["reported"]["0.4"] >= share["reported"]["0.9"]
    text = run("eval", "m", "plain", "--min-score", 0.6, *TINY_RUN).stdout
    assert len(text.splitlines()) == 4
    assert "at score 0.60" in text


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


def test_lines_needs_proposals_to_train_on() -> None:
    result = run("lines", "--scenes", 1, "--weights", "w.safetensors", "-o", "new.safetensors")
    assert result.exit_code != 0
    assert "too few proposals in 1 scenes to train on; draw more scenes" in str(result.exception)


def test_eval_of_lines_with_the_papers_scores_and_drawn_images(tmp_path: Path) -> None:
    write_masks(tmp_path / "m")
    photos(tmp_path / "plain")
    words = ("eval", "m", "plain", "--use", "lines", "--paper", "--synthetic", 2, "--json", *TINY_RUN)
    result = run(*words)
    assert (result.exit_code, result.stderr) == (0, "")
    rows = [json.loads(line) for line in result.stdout.splitlines()]
    assert [("ods" in t, "apr" in t, "reported" in t, "sap10" in t).index(True) for t in rows] == [
        *(0, 0, 0),
        *[1] * 10,
        *(2, 3),
    ]
    assert rows[-1]["images"] == 2
    assert "with a reported line" in run("eval", "plain", "--use", "lines", *TINY_RUN).stdout


def test_eval_of_a_rival(tmp_path: Path) -> None:
    write_masks(tmp_path / "m")
    rows = [json.loads(line) for line in run("eval", "m", "--rival", "lsd", "--json").stdout.splitlines()]
    assert rows[0]["ods"]["recall"] == 1  # the edges of the band are within its half width


def test_eval_of_nothing_is_one_line() -> None:
    assert "give folders of images, or a number of synthetic" in str(run("eval", *TINY_RUN).exception)
    result = run("eval", "plain", "--background", "plain", *TINY_RUN)
    assert "backgrounds are for synthetic images only" in str(result.exception)


def test_eval_of_no_images_is_one_line() -> None:
    result = run("eval", "none", *TINY_RUN)
    assert isinstance(result.exception, LSNetError)
    assert str(result.exception).startswith("none: no images to evaluate")


def test_train_and_export_and_detect(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _validate_on_few_images(monkeypatch)
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
    _validate_on_few_images(monkeypatch)
    words = ("--run", "run", "--background", photos(tmp_path / "photos"), "--preset", "tiny", "--crop", 64)
    steps = ("--steps", 1, "--batch-size", 2, "--validate-every", 1, "--workers", 0, "--device", "cpu")
    result = run("train", "--recipe", "paper", "--loss", "weight=3", *words, *steps)
    assert (result.exit_code, result.stderr) == (0, "")
    kept = checkpoints.load_checkpoint(tmp_path / "run/best.pt")["recipe"]
    assert (kept["learning_rate"], kept["schedule"], kept["clip_norm"]) == (1e-4, "constant", None)
    assert (kept["loss"]["weight"], kept["off_centre_penalty"]) == (3.0, 0.0)
    assert kept["data"].endswith("last tenth held out, augmentations of the paper")


def test_eval_by_the_protocol_of_the_paper_with_other_options(tmp_path: Path) -> None:
    write_masks(tmp_path / "m")
    words = ("eval", "m", "--paper", "--json", *TINY_RUN)
    for options, expected in (((), (0.4, 1.0)), (("--min-score", 0.7, "--sigma", 2), (0.7, 2.0))):
        rows = [json.loads(line) for line in run(*words, *options).stdout.splitlines()][3:]
        assert len(rows) == 10
        assert {(row["min_score"], row["sigma_px"]) for row in rows} == {expected}


def test_grids_of_a_rival_are_one_line() -> None:
    result = run("eval", "m", "--rival", "lsd", "--grids", "M")
    assert "only LS-Net has grids; leave out the grids or the rival" in str(result.exception)


def test_compare_prints_a_table_and_draws_a_chart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compare, "NETWORKS", (compare.SizedVariant("small", TINY),))
    monkeypatch.setattr(compare, "cpu_ms_of", lambda _network: {"torch": 2.0, "openvino f32": 1.0})
    monkeypatch.setattr(trainings, "VALIDATION_IMAGES", 1)
    words = (
        "compare",
        write_masks(tmp_path / "m"),
        "--run",
        "run",
        "--images",
        2,
        "--steps",
        1,
        "--workers",
        0,
    )
    made = run(*words, "--chart", "chart.svg")
    assert (made.exit_code, made.stderr) == (0, "")
    assert made.stdout.splitlines()[0].endswith("| ODS m | ms, torch | ms, openvino f32 |")
    assert ">small<" in (tmp_path / "chart.svg").read_text()
    (rows,) = (json.loads(line) for line in run(*words, "--json").stdout.splitlines())
    assert rows["result"]["name"] == "small"
    assert rows["cpu_ms"] == {"torch": 2.0, "openvino f32": 1.0}
    other = run(*words, "--what", "rivals", "--chart", "chart.svg")
    assert "leave out --chart or --what rivals" in str(other.exception)


def test_ablate_prints_the_figures_of_the_paper_beside(tmp_path: Path) -> None:
    write_masks(tmp_path / "m")
    result = run("ablate", "m", *TINY_RUN)
    assert (result.exit_code, result.stderr) == (0, "")
    heads, _, *rows = result.stdout.splitlines()
    assert heads == "| grids | set | APR | ARR | F1 | F1 above LS-Net | paper: APR | ARR | F1 |"
    assert [row.split(" | ")[0] for row in rows] == [
        *("| LS-Net-1-M", "| LS-Net-2-MH", "| LS-Net-2-MV", "| LS-Net-2-MC"),
        *("| LS-Net-3-MHC", "| LS-Net-3-MVC", "| LS-Net-3-MVH", "| LS-Net-4-MHVC"),
    ]
    assert rows[0].endswith("| 0.8312 | 0.3791 | 0.4847 |")
    (first, *_) = run("ablate", "m", "--what", "grids", "--json", *TINY_RUN).stdout.splitlines()
    assert json.loads(first)["published"] == [0.8312, 0.3791, 0.4847]


def test_ablate_trains_in_the_folder_of_a_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trainings, "VALIDATION_IMAGES", 4)
    monkeypatch.setattr("lsnet.evaluation.compare.ablation.thin_paper", lambda _thinner: TINY)
    size = ("--images", 1, "--steps", 1, "--batch-size", 1, "--crop", 64, "--seeds", 1, "--workers", 0)
    words = ("ablate", write_masks(tmp_path / "m"), "--run", "run", "--what", "classification")
    result = run(*words, *size, "--device", "cpu")
    assert (result.exit_code, result.stderr) == (0, "")
    assert [row.split(" | ")[0] for row in result.stdout.splitlines()[2::2]] == ["| LS-Net-CE", "| LS-Net-FL"]
    assert run(*words, *size, "--device", "cpu").stdout == result.stdout


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "give --run to train, or --weights"),
        (("--run", "run", "--weights", "fast"), "give --run to train, or --weights"),
        (("--weights", "fast", "--what", "regression"), "only the ablation of the grids needs no training"),
        (("--run", "run", "--method", "wing"), "no method 'wing' to train; choose of LS-Net-P"),
    ],
)
def test_unusable_ablations_are_one_line(arguments: tuple[str, ...], message: str) -> None:
    assert message in str(run("ablate", "m", *arguments).exception)


def test_train_and_evaluate_a_rival(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _validate_on_few_images(monkeypatch)
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
    _validate_on_few_images(monkeypatch)
    made = run("synth", "-o", "renders", "--count", 1, "--size", 64)
    assert made.stdout == "renders: 1 pictures; next: lsnet-pipe model train --rendered renders\n"
    words = ("--run", "run", "--rendered", "renders", "--preset", "tiny", "--crop", 64, "--workers", 0)
    trained = run("train", *words, "--steps", 1, "--batch-size", 2, "--validate-every", 1)
    assert (trained.exit_code, trained.stderr) == (0, "")
    kept = checkpoints.load_checkpoint(tmp_path / "run/last.pt")["recipe"]
    assert kept["data"] == "renders over plain grounds, 64 px, seed 0, last tenth held out"


def _validate_on_few_images(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, defaults in recipe.RECIPES.items():
        monkeypatch.setitem(recipe.RECIPES, name, replace(defaults, validation_images=2))


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


def test_bench_of_an_untrained_preset() -> None:
    result = run("bench", "--preset", "tiny", "--json", "--size", 32, "--seconds", 0.1, "--runtime", "torch")
    assert (result.exit_code, result.stderr) == (0, "")
    assert json.loads(result.stdout)["preset"] == "tiny"
    assert "no preset 'huge'; choose one of" in str(run("bench", "--preset", "huge").exception)


def test_import_and_evaluate_a_published_set(tmp_path: Path) -> None:
    (tmp_path / "in/gt").mkdir(parents=True)
    cv2.imwrite("in/1.bmp", np.full((40, 50, 3), 90, np.uint8))
    cv2.imwrite("in/2.bmp", np.full((40, 50, 3), 90, np.uint8))
    cv2.imwrite("in/gt/1.bmp", np.zeros((40, 50), np.uint8))
    result = run("import", "in", "-o", "set")
    assert result.stdout == (
        "set: 1 images; 1 images without a mask left out; next: lsnet-pipe model eval set --paper\n"
    )
    assert len(run("eval", "set", "--paper", *TINY_RUN).stdout.splitlines()) == 13


def test_figures_are_pictures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_masks(tmp_path / "m")
    figures = {
        ("detections", "m", "--rival", "hough", "--width", 64, *TINY_RUN): (3 + 1) * (64 + 4),
        ("grids", "m/images/a.jpg", "--width", 64, *TINY_RUN): 4 * (64 + 4),
        ("augmentations", "--size", 64): 4 * (64 + 4),
    }
    for words, width in figures.items():
        result = run("figure", *words, "-o", "figure.png")
        assert (result.exit_code, result.stdout) == (0, "figure.png\n"), words
        assert cv2.imread("figure.png").shape[1] == width
    assert run("figure", "grids", "m/images/a.jpg", "-o", "figure.pdf", *TINY_RUN).exit_code == 2
