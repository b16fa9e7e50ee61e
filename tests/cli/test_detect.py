"""`lsnet-pipe detect` as its users meet it, with a tiny network of random weights."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
from nets import save_tiny
from typer.testing import CliRunner

import cli
from inspect_pipeline.errors import OutputError
from lsnet import LSNetError

if TYPE_CHECKING:
    from pathlib import Path

    from click.testing import Result

SIZES = {"a.png": (100, 130), "b.jpg": (90, 112), "c.png": (100, 130)}  # height, width


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with three photographs, weights, and a file that is no image."""
    monkeypatch.chdir(tmp_path)
    save_tiny(tmp_path / "w.safetensors", min_score=0.4)
    rng = np.random.default_rng(0)
    for name, (height, width) in SIZES.items():
        coarse = rng.integers(0, 256, (6, 8, 3), dtype=np.uint8)
        cv2.imwrite(name, cv2.resize(coarse, (width, height), interpolation=cv2.INTER_NEAREST))
    (tmp_path / "bad.jpg").write_text("no image")
    return tmp_path


def detect(*arguments: object) -> Result:
    words = ["detect", *arguments, "--weights", "w.safetensors", "--runtime", "torch"]
    return CliRunner().invoke(cli.app, [str(word) for word in words])


def rows(result: Result) -> list[dict[str, Any]]:
    return [json.loads(line) for line in result.stdout.splitlines()]


@pytest.mark.usefixtures("folder")
def test_one_object_a_line_with_the_fields_promised() -> None:
    result = detect(*SIZES, "--json")
    assert (result.exit_code, result.stderr) == (0, "")
    for row, (name, (height, width)) in zip(rows(result), SIZES.items(), strict=True):
        assert set(row) == {"path", "width", "height", "segments", "lines"}
        assert (row["path"], row["width"], row["height"]) == (name, width, height)
        assert row["segments"]
        for x1, y1, x2, y2, score in row["segments"]:
            assert 0 <= min(x1, x2) <= max(x1, x2) <= width
            assert 0 <= min(y1, y2) <= max(y1, y2) <= height
            assert 0.4 <= score <= 1
        assert isinstance(row["lines"], list)


@pytest.mark.usefixtures("folder")
def test_least_scores_down_to_a_twentieth() -> None:
    counts = []
    for least in (0.05, 0.5, 0.95):
        (row,) = rows(detect("a.png", "--json", "--min-score", least))
        assert all(segment[4] >= least for segment in row["segments"])
        counts.append(len(row["segments"]))
    assert counts[0] > counts[1] >= counts[2]


@pytest.mark.usefixtures("folder")
def test_the_batch_size_changes_nothing() -> None:
    names = ["a.png", "b.jpg", "bad.jpg", "a.png"]
    outputs = [detect(*names, "--json", "--batch-size", size) for size in (1, 3)]
    assert len(rows(outputs[0])) == 3
    assert outputs[0].stdout == outputs[1].stdout
    assert {o.exit_code for o in outputs} == {1}


@pytest.mark.usefixtures("folder")
def test_an_unreadable_image_is_one_line_and_the_others_are_done(capfd: pytest.CaptureFixture[str]) -> None:
    result = detect("a.png", "bad.jpg", "none.jpg", "c.png", "--json")
    assert result.exit_code == 1
    assert [row["path"] for row in rows(result)] == ["a.png", "c.png"]
    first, second = result.stderr.splitlines()
    assert first == "error: none.jpg: there is no such file; check the name"
    assert (
        second == "error: bad.jpg: the image is not of a format that can be read; give a JPEG, PNG or similar"
    )
    assert capfd.readouterr().err == ""  # nothing from the libraries beneath either


@pytest.mark.parametrize("name", ["a.png", "b.jpg"])
def test_a_photograph_that_is_cut_off(folder: Path, name: str, capfd: pytest.CaptureFixture[str]) -> None:
    """As in recordings: unreadable, without a word from the libraries beneath."""
    (folder / name).write_bytes((folder / name).read_bytes()[:1500])
    result = detect(name, "--json")
    assert (result.exit_code, result.stdout) == (1, "")
    assert result.stderr == f"error: {name}: the image is cut off; give a JPEG, PNG or similar\n"
    assert capfd.readouterr().err == ""


def test_a_damaged_photograph_is_a_warning(folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    data = (folder / "b.jpg").read_bytes()
    (folder / "b.jpg").write_bytes(data[:-2] + b"\0\1\2\3" + data[-2:])
    result = detect("b.jpg", "--json")
    assert (result.exit_code, len(rows(result))) == (0, 1)
    assert result.stderr.startswith("warning: b.jpg: the image is damaged: Corrupt JPEG data: ")
    assert capfd.readouterr().err == ""


@pytest.mark.usefixtures("folder")
def test_without_json_a_sentence_an_image() -> None:
    (row,) = rows(detect("a.png", "--json"))
    n_lines, n_segments = len(row["lines"]), len(row["segments"])
    counts = f"{n_lines} line{'s' * (n_lines != 1)} of {n_segments} segment{'s' * (n_segments != 1)}"
    assert detect("a.png").stdout == f"a.png: 130x100, {counts}\n"


def test_overlays_and_maps(folder: Path) -> None:
    assert detect("a.png", "b.jpg", "--draw", "lines", "--map", "maps").exit_code == 0
    result = detect("a.png", "b.jpg", "--json", "--draw", "segments", "--segments")
    for row in rows(result):
        stem = row["path"].split(".")[0]
        source = cv2.imread(str(folder / row["path"]))
        lines, segments, heat = (
            cv2.imread(str(folder / f"{kind}/{stem}.png")) for kind in ("lines", "segments", "maps")
        )
        assert lines.shape == segments.shape == heat.shape == source.shape
        assert (lines != source).any() == bool(row["lines"])
        assert (segments != source).any()
        x1, y1, _, _, _ = max(row["segments"], key=lambda s: s[4])
        column, line = min(int(x1), row["width"] - 1), min(int(y1), row["height"] - 1)
        assert heat[line, column].sum() > np.median(heat.sum(axis=2))


def test_pictures_keep_the_folders_of_their_photographs(folder: Path) -> None:
    for name in ("1", "2"):
        (folder / name).mkdir()
        (folder / name / "x.jpg").write_bytes((folder / "b.jpg").read_bytes())
    assert detect("1/x.jpg", "2/x.jpg", "--draw", "out").exit_code == 0
    assert sorted(path.relative_to(folder).as_posix() for path in folder.glob("out/*/*")) == [
        "out/1/x.png",
        "out/2/x.png",
    ]


def test_no_picture_replaces_another_or_its_photograph(folder: Path) -> None:
    before = (folder / "a.png").read_bytes()
    (folder / "a.jpg").write_bytes((folder / "b.jpg").read_bytes())
    for arguments in (
        ("a.png", "--draw", "."),
        ("a.png", "--draw", "out", "--map", "out"),
        ("a.png", "a.jpg", "--draw", "out"),
    ):
        result = detect(*arguments)
        assert isinstance(result.exception, OutputError), arguments
        assert "\n" not in str(result.exception)
    assert (folder / "a.png").read_bytes() == before
    assert detect("a.png", "a.png", "--draw", "out").exit_code == 0


def test_pictures_that_cannot_be_written_are_one_line(folder: Path) -> None:
    (folder / "file").touch()
    result = detect("a.png", "--draw", "file")
    assert isinstance(result.exception, OutputError)
    assert str(result.exception).startswith("file: cannot be created")


@pytest.mark.usefixtures("folder")
def test_the_scale_keeps_source_pixels() -> None:
    (row,) = rows(detect("a.png", "--json", "--scale", 2, "--min-score", 0.05))
    (same,) = rows(detect("a.png", "--json", "--scale", 1, "--min-score", 0.05))
    assert (row["width"], row["height"]) == (130, 100)
    assert len(row["segments"]) > len(same["segments"])
    assert max(s[0] for s in row["segments"]) <= 130


@pytest.mark.parametrize(
    "option", [("--scale", 9), ("--min-score", 2), ("--batch-size", 0), ("--nonesuch",)], ids=lambda o: o[0]
)
@pytest.mark.usefixtures("folder")
def test_options_out_of_range_are_usage_errors(option: tuple[object, ...]) -> None:
    assert detect("a.png", *option).exit_code == 2


@pytest.mark.usefixtures("folder")
def test_weights_that_are_not_there_are_one_line() -> None:
    result = CliRunner().invoke(cli.app, ["detect", "a.png", "--weights", "nonesuch"])
    assert isinstance(result.exception, LSNetError)
    assert "nonesuch: no such weights" in str(result.exception)


def test_folders_and_globs(folder: Path) -> None:
    (folder / "photos" / "below").mkdir(parents=True)
    for name in ("photos/x.JPG", "photos/below/y.jpg"):
        (folder / name).write_bytes((folder / "b.jpg").read_bytes())
    (folder / "photos" / "notes.txt").touch()
    both = ["photos/below/y.jpg", "photos/x.JPG"]
    assert sorted(row["path"] for row in rows(detect("photos", "--json"))) == both
    assert sorted(row["path"] for row in rows(detect("photos/**/*.[jJ]*", "--json"))) == both


def test_missing_images_are_reported_before_anything_loads(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lsnet.Detector", None)
    (folder / "empty").mkdir()
    result = detect("none.jpg", "none/*.jpg", "empty")
    assert result.exit_code == 1
    assert result.stderr.splitlines() == [
        "error: none.jpg: there is no such file; check the name",
        "error: none/*.jpg: there is no such file; check the name",
        "error: empty: there is no image in it; check the name",
    ]
