"""Commands that read a store or a recording: lists, info, doctor, query, overlay."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import TYPE_CHECKING

import cv2
import pytest
from factories import make_recording, shots

from inspect_pipeline.index.reading import select
from inspect_pipeline.store.store import Store

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from command_line import Outcome


def test_info(run: Callable[..., Outcome], flight: str, tmp_path: Path) -> None:
    out = run("info", "a.mcap").out
    assert "/camera/image/compressed: 3 messages (foxglove.CompressedImage, protobuf)" in out
    assert "/gps: 6 messages (Gps, json)" in out
    assert "2023-11-14 22:13:20 to 2023-11-14 22:13:21 UTC" in out
    assert out.splitlines()[-1].split() == ["process", "/camera/image/compressed"]
    (copy,) = tmp_path.rglob("annotated.mcap")
    assert "nothing: this is an annotated copy" in run("info", copy).out


def test_doctor(run: Callable[..., Outcome], flight: str, tmp_path: Path) -> None:
    outcome = run("doctor", "--store", "none")
    assert outcome.exit_code == 0
    assert "none yet" in outcome.out
    assert "1 flight, 0 damaged" in run("doctor").out
    (tmp_path / "store" / "index.duckdb").unlink()
    outcome = run("doctor")
    assert outcome.exit_code == 1
    assert "lsnet-pipe index rebuild" in outcome.out
    assert run("doctor", "--store", "a.mcap").exit_code == 1


def test_overlay(run: Callable[..., Outcome], flight: str) -> None:
    assert "frame 2 of /camera/image/compressed, 0 lines" in run("overlay", flight[:6], "-o", "o.png").out
    assert (
        "frame 2 of /camera/image/compressed, 2 segments"
        in run("overlay", flight[:6], "--segments", "-o", "o.png").out
    )
    height, width, _ = cv2.imread("o.png").shape
    assert (width, height > 12) == (16, True)  # with the strip below
    assert "frame 1 of" in run("overlay", flight, "--frame", 1, "-o", "o.jpg").out
    for arguments, words in (
        ((flight, "--frame", 9, "-o", "o.png"), "no decoded frame like that"),
        ((flight, "--topic", "/it's", "-o", "o.png"), "no decoded frame like that"),
        (("xyz", "-o", "o.png"), "no flight begins with 'xyz'"),
        ((flight, "-o", "no/o.png"), "cannot be written"),
    ):
        outcome = run("overlay", *arguments)
        assert (outcome.exit_code, outcome.err.count("\n")) == (1, 1)
        assert words in outcome.err


def test_overlays_of_all_frames(run: Callable[..., Outcome], flight: str, tmp_path: Path) -> None:
    assert run("overlay", flight[:6], "-o", "frames").out.startswith("frames: 3 frames of /camera/image")
    names = ["frame-000000.jpg", "frame-000001.jpg", "frame-000002.jpg"]
    assert sorted(path.name for path in (tmp_path / "frames").iterdir()) == names
    av = pytest.importorskip("av")
    assert "a.mp4: 3 frames" in run("overlay", flight, "-o", "a.mp4").out
    times = select(Store(tmp_path / "store"), "SELECT log_time_ns AS ns FROM frames ORDER BY log_time_ns")
    with av.open("a.mp4") as film:
        shown = [float(picture.time) for picture in film.decode(video=0)]
    expected = [(row["ns"] - times[0]["ns"]) / 1e9 for row in times]
    assert shown == pytest.approx(expected, abs=0.002)


def test_a_reader_that_leaves_is_no_error(tmp_path: Path) -> None:
    make_recording(tmp_path / "a.mcap", shots(1))
    program = "import cli; cli.main()"
    with subprocess.Popen(
        [sys.executable, "-c", program, "info", "a.mcap"],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as child:
        child.stdout.close()
        assert child.stderr.read() == b""


def test_lists_that_are_empty_say_so(run: Callable[..., Outcome], flight: str) -> None:
    for line in run("anomalies", "list").out.splitlines()[1:]:
        run("anomalies", "mark", line.split()[0], "dismissed")
    assert run("anomalies", "list").out == "no open anomalies; --all lists the reviewed ones\n"
    assert run("spans", "list").out.startswith("no spans; ")
    assert run("quarantine", "list").out == "no recordings in quarantine\n"
    assert run("flights", "list").out.splitlines()[0].split()[:2] == ["flight_id", "start"]


def test_times_in_a_zone(run: Callable[..., Outcome], tmp_path: Path) -> None:
    make_recording(tmp_path / "a b%.mcap", shots(1))  # 2023-11-14 22:13:20 UTC
    run("process", "a b%.mcap")
    assert "2023-11-14T22:13:20Z" in run("flights", "list").out
    listed = run("flights", "list", "--timezone", "Europe/Zurich").out
    assert "2023-11-14T23:13:20+01:00" in listed
    assert "a b%.mcap" in listed


def test_the_suffix_decides_the_format_and_nothing_is_cut(
    run: Callable[..., Outcome], flight: str, tmp_path: Path
) -> None:
    sql = "SELECT range AS i, repeat('x', 200) AS long FROM range(1500)"
    for name in ("t.csv", "t.txt", "t.json"):
        assert run("query", sql, "-o", name).exit_code == 0
        text = (tmp_path / name).read_text()
        assert text.count("x" * 200) == 1500
    assert (tmp_path / "t.csv").read_text().splitlines()[0] == "i,long"
    assert len(json.loads((tmp_path / "t.json").read_text())) == 1500
    assert run("query", sql).out.endswith("(1500 rows)\n")  # into a pipe
    assert (
        run("query", "SELECT flight_id FROM flights").out.splitlines()[2]
        == (run("flights", "list").out.splitlines()[1].split()[0])
    )
