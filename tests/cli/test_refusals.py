"""What cannot be processed: one line each, which names the file and what to do, and an exit code."""

from __future__ import annotations

import json
import os
import subprocess
from typing import TYPE_CHECKING, Any

import pytest
from factories import ENCODINGS, Encoding, make_recording, shots
from fakes import FakeDetector

import lsnet

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from command_line import Outcome


def test_a_store_of_a_newer_version_exits_12(
    run: Callable[..., Outcome], flight: str, tmp_path: Path
) -> None:
    (result,) = (tmp_path / "store").glob("flights/*/result.json")
    result.write_text(json.dumps(json.loads(result.read_text()) | {"result_version": 99}))
    for command in (("process", "a.mcap"), ("index", "verify"), ("index", "rebuild")):
        outcome = run(*command)
        assert (outcome.exit_code, "upgrade lsnet-pipe" in outcome.err) == (12, True)


def _not_an_mcap(path: Path) -> None:
    path.write_bytes(b"GIF89a" * 100)


def _empty(path: Path) -> None:
    path.touch()


def _folder(path: Path) -> None:
    path.mkdir()


def _missing(path: Path) -> None:
    pass


def _no_camera(path: Path) -> None:
    make_recording(path, [])


def _unknown_encoding(path: Path) -> None:
    odd = Encoding("foxglove.CompressedImage", "", b"", "bson", ENCODINGS["protobuf"].encode)
    make_recording(path, shots(2), encoding=odd)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (_not_an_mcap, "MCAP"),
        (_empty, "empty"),
        (_folder, "lsnet-pipe pack"),
        (_missing, "there is no such file"),
        (_no_camera, "no camera topic"),
        (_unknown_encoding, "bson"),
    ],
)
def test_what_cannot_be_processed_is_one_line(
    run: Callable[..., Outcome], tmp_path: Path, spoil: Callable[[Path], None], words: str
) -> None:
    spoil(tmp_path / "a.mcap")
    outcome = run("process", "a.mcap")
    assert (outcome.exit_code, outcome.out) == (1, "")
    assert outcome.err.count("\n") == 1
    assert outcome.err.startswith("error: a.mcap: ")
    assert words in outcome.err
    assert ";" in outcome.err  # what to do about it
    assert not list((tmp_path / "store").rglob("*.mcap"))


def test_a_recording_that_is_cut_off(run: Callable[..., Outcome], tmp_path: Path) -> None:
    make_recording(tmp_path / "a.mcap", shots(40))
    os.truncate(tmp_path / "a.mcap", (tmp_path / "a.mcap").stat().st_size // 2)
    outcome = run("process", "a.mcap", "--strict")
    assert (outcome.exit_code, outcome.out, outcome.err.count("\n")) == (1, "", 1)
    assert "cut off" in outcome.err
    assert "process the part that can be read" in outcome.err
    outcome = run("process", "a.mcap", "--json")
    result = json.loads(outcome.out)
    assert (outcome.exit_code, result["status"]) == (0, "recovered")
    assert 0 < result["n_frames"] < 40
    assert "bytes are lost" in result["reason"]
    assert outcome.err == f"warning: a.mcap: recovered: {result['reason']}\n"
    assert run("process", "a.mcap").err == ""  # reported once


def test_what_is_odd_about_a_recording_is_a_warning(run: Callable[..., Outcome], tmp_path: Path) -> None:
    make_recording(tmp_path / "a.mcap", [shot._replace(topic="/a\x1b[2J") for shot in shots(30)] * 2)
    outcome = run("process", "a.mcap", "--json")
    warnings = json.loads(outcome.out)["warnings"]
    assert outcome.exit_code == 0
    assert len(warnings) == 2
    assert outcome.err.splitlines() == [f"warning: a.mcap: {w}".replace("\x1b", "?") for w in warnings]
    assert warnings[1] == "/a\x1b[2J: 30 images with the header stamp of the one before"


@pytest.mark.parametrize("command", ["process", "info"])
def test_a_missing_recording_is_one_line_everywhere(run: Callable[..., Outcome], command: str) -> None:
    outcome = run(command, "none.mcap")
    assert outcome.err == "error: none.mcap: there is no such file; check the name\n"
    assert outcome.exit_code == 1


def test_no_detector_is_loaded_for_what_is_not_there(
    run: Callable[..., Outcome], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(FakeDetector, "load", None)
    (tmp_path / "empty").mkdir()
    outcome = run("process", "none.mcap", "empty")
    assert (outcome.exit_code, outcome.out) == (1, "")
    first, second = outcome.err.splitlines()
    assert first == "error: none.mcap: there is no such file; check the name"
    assert second.startswith("error: empty: the folder has no recording; ")


@pytest.mark.parametrize("store", ["taken", "taken/below", "/sys/lsnet-pipe"])
def test_a_store_that_cannot_be_written_is_one_line(
    run: Callable[..., Outcome], tmp_path: Path, store: str
) -> None:
    """A file in its place, a file above it, and a file system that nobody can write to."""
    (tmp_path / "taken").touch()
    make_recording(tmp_path / "a.mcap", shots(2))
    outcome = run("process", "a.mcap", "a.mcap", "--store", store)
    assert (outcome.exit_code, outcome.out) == (1, "")
    assert outcome.err.count("\n") == 1
    assert store in outcome.err
    assert "--store" in outcome.err


def test_a_read_only_store_is_one_line(run: Callable[..., Outcome], tmp_path: Path) -> None:
    make_recording(tmp_path / "a.mcap", shots(2))
    store = tmp_path / "read-only"
    store.mkdir()
    try:
        subprocess.run(["mount", "-t", "tmpfs", "-o", "ro", "none", store], check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("needs the right to mount")
    try:
        outcome = run("process", "a.mcap", "--store", store)
    finally:
        subprocess.run(["umount", store], check=True)
    assert (outcome.exit_code, outcome.err.count("\n")) == (1, 1)
    assert "read-only" in outcome.err


def test_errors_of_the_detector_are_one_line(
    run: Callable[..., Outcome], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*arguments: Any, **options: Any) -> None:
        raise lsnet.LSNetError("no weights named 'mine'; there are: fast")

    monkeypatch.setattr(FakeDetector, "load", refuse)
    (tmp_path / "a.mcap").touch()
    outcome = run("process", "a.mcap", "--weights", "mine")
    assert (outcome.exit_code, outcome.err) == (1, "error: no weights named 'mine'; there are: fast\n")


@pytest.mark.parametrize(
    "command",
    [
        ("query", "SELECT 1"),
        ("flights", "list"),
        ("flights", "rm", "ab"),
        ("anomalies", "list"),
        ("spans", "list"),
        ("check",),
        ("runs",),
        ("quarantine", "list"),
        ("index", "verify"),
        ("index", "rebuild"),
        ("overlay", "ab", "-o", "o.png"),
    ],
    ids=" ".join,
)
def test_a_mistyped_store_is_not_created(
    run: Callable[..., Outcome], tmp_path: Path, command: tuple[str, ...]
) -> None:
    outcome = run(*command, "--store", "mistyped")
    assert (outcome.exit_code, outcome.out) == (1, "")
    assert f"{tmp_path}/mistyped: there is no store; check the name" in outcome.err
    assert not (tmp_path / "mistyped").exists()
