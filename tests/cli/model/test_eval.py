"""`lsnet-pipe model eval|bench|import|figure`, on tiny networks and few images."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import cv2
import numpy as np
from evaluation_sets import write_masks
from model_commands import TINY_RUN, photos, run

from lsnet import LSNetError

if TYPE_CHECKING:
    from pathlib import Path

    import pytest


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
