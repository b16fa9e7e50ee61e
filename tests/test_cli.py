"""The command line as its users meet it: what is printed where, and with which exit code."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import pytest
from factories import ENCODINGS, Encoding, make_recording, shots
from fakes import FakeDetector
from inline_queries import answer_here

import cli
import lsnet
from inspect_pipeline.index.reading import select
from inspect_pipeline.store.store import Store

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

HELP = (
    "",
    "process",
    "query",
    "info",
    "detect",
    "overlay",
    "pack",
    "simulate",
    "doctor",
    "index rebuild",
    "batch",
    "quarantine retry",
    "schedule",
    "runs",
    "model bench",
)


class Outcome:
    """What a command left: exit code, stdout and stderr."""

    def __init__(self, exit_code: int, out: str, err: str) -> None:
        self.exit_code, self.out, self.err = exit_code, out, err


@pytest.fixture
def run(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> Iterator[Callable[..., Outcome]]:
    """Run `lsnet-pipe ...` in this process, with a fake detector, in a folder of its own."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("LSNET_PIPE_STORE", str(tmp_path / "store"))
    monkeypatch.setattr(lsnet, "Detector", FakeDetector)
    answer_here(monkeypatch)
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def run(*arguments: object) -> Outcome:
        monkeypatch.setattr(sys, "argv", ["lsnet-pipe", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        captured = capfd.readouterr()
        return Outcome(int(ended.value.code or 0), captured.out, captured.err)

    yield run
    for number, handler in handlers.items():
        signal.signal(number, handler)


def test_process_prints_one_object_per_recording(run: Callable[..., Outcome], tmp_path: Path) -> None:
    make_recording(tmp_path / "a.mcap", shots(3))
    make_recording(tmp_path / "b.mcap", shots(4, "/other"))
    outcome = run("process", "a.mcap", "b.mcap", "--json")
    first, second = map(json.loads, outcome.out.splitlines())
    assert (outcome.exit_code, outcome.err) == (0, "")
    assert (first["source"], first["status"], first["n_frames"], first["n_segments"]) == (
        "a.mcap",
        "ok",
        3,
        3,
    )
    assert (first["n_bad_frames"], second["n_frames"]) == (0, 4)
    assert first["annotated"] == f"{tmp_path}/store/flights/{first['flight_id'][:16]}/annotated.mcap"
    assert os.path.getsize(first["annotated"]) > (tmp_path / "a.mcap").stat().st_size  # noqa: PTH202
    assert set(first) == {
        *("flight_id", "source", "status", "annotated"),
        *("n_frames", "n_bad_frames", "n_segments", "n_lines", "seconds", "reason", "warnings"),
        "n_frames_replaced",
    }


def test_process_prints_a_table(run: Callable[..., Outcome], tmp_path: Path) -> None:
    make_recording(tmp_path / "a.mcap", shots(3))
    head, row = run("process", "a.mcap").out.splitlines()
    assert head.split() == [
        *("flight_id", "status", "n_frames", "n_bad_frames", "n_lines", "seconds", "source")
    ]
    assert row.split()[1:5] == ["ok", "3", "0", "0"]
    assert run("process", "a.mcap").out.splitlines()[1].split()[1] == "skipped"


def test_process_then_query(run: Callable[..., Outcome], tmp_path: Path) -> None:
    make_recording(tmp_path / "a.mcap", shots(3))
    run("process", "a.mcap")
    outcome = run("query", "SELECT frame_idx, n_segments FROM frames ORDER BY ALL", "--format", "json")
    assert json.loads(outcome.out) == [{"frame_idx": i, "n_segments": i} for i in range(3)]


def test_process_reaches_the_options(run: Callable[..., Outcome], tmp_path: Path) -> None:
    make_recording(tmp_path / "a.mcap", [*shots(9), *shots(9, "/other")])
    times = ("--start", "2023-11-14T22:13:21Z", "--end", "1700000003000000000")
    outcome = run("process", "a.mcap", "--topic", "/other", "--every", 2, *times, "--json")
    assert outcome.err == ""
    assert json.loads(outcome.out)["n_frames"] == 2
    frames = run(
        "query", "SELECT frame_idx, topic FROM frames JOIN channels USING (channel_id)", "--format", "csv"
    )
    assert frames.out.split() == ["frame_idx,topic", "2,/other", "4,/other"]
    outcome = run("process", "a.mcap", "--weights", "w", "--scale", 0.5, "--min-score", 0.25, "--force")
    assert outcome.exit_code == 0
    (row,) = json.loads(
        run("query", "SELECT config FROM runs ORDER BY started_at DESC LIMIT 1", "--format", "json").out
    )
    config = row["config"] if isinstance(row["config"], dict) else json.loads(row["config"])
    assert config["detector"] | {"weights": "w", "scale": 0.5, "min_score": 0.25} == config["detector"]


def test_process_goes_on_past_a_bad_recording(run: Callable[..., Outcome], tmp_path: Path) -> None:
    (tmp_path / "bad.mcap").write_bytes(b"no recording")
    make_recording(tmp_path / "good.mcap", shots(2))
    outcome = run("process", "bad.mcap", "good.mcap", "--json")
    assert (outcome.exit_code, json.loads(outcome.out)["status"]) == (1, "ok")
    assert outcome.err.startswith("error: bad.mcap: ")
    assert run("query", "SELECT count(*) AS n FROM flights", "--format", "csv").out.split() == ["n", "1"]


def test_process_goes_on_past_a_recording_that_vanishes(
    run: Callable[..., Outcome], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("a", "b"):
        make_recording(tmp_path / f"{name}.mcap", shots(3, f"/{name}"))
    whole = FakeDetector.detect

    def detect(self: FakeDetector, images: Any, **_: object) -> Any:
        (tmp_path / "a.mcap").unlink(missing_ok=True)
        return whole(self, images)

    monkeypatch.setattr(FakeDetector, "detect", detect)
    outcome = run("process", "a.mcap", "b.mcap", "--json")
    assert outcome.exit_code == 1
    assert outcome.err == "error: a.mcap: it cannot be read (No such file or directory); check the disk\n"
    assert [json.loads(line)["source"] for line in outcome.out.splitlines()] == ["b.mcap"]


def test_names_that_are_no_text(run: Callable[..., Outcome], tmp_path: Path) -> None:
    path = make_recording(tmp_path / os.fsdecode(b"\xff[red].mcap"), shots(1, "/a\x1b[31m"))
    assert run("process", path).exit_code == 0
    outcome = run("info", path)
    assert outcome.exit_code == 0
    assert "?[red].mcap" in outcome.out
    assert "  /a?[31m: 1 messages" in outcome.out
    assert run("flights", "list").exit_code == 0
    assert (
        run("process", f"{path}.gone").err
        == f"error: {tmp_path}/?[red].mcap.gone: there is no such file; check the name\n"
    )


def test_a_process_is_a_run(run: Callable[..., Outcome], tmp_path: Path) -> None:
    make_recording(tmp_path / "a.mcap", shots(3))
    (tmp_path / "bad.mcap").write_bytes(b"no recording")
    assert run("process", "bad.mcap").exit_code == 1
    assert not (tmp_path / "store").exists()
    assert run("process", "a.mcap", "bad.mcap").exit_code == 1
    assert run("process", "a.mcap").exit_code == 0  # nothing is done, and nothing is kept of it
    (summary,) = (json.loads(line) for line in run("runs", "--json").out.splitlines())
    assert (summary["command"], summary["exit_code"], summary["tags"]) == ("process", 1, {})
    assert {name: n for name, n in summary["counts"].items() if n} == {
        "n_found": 2,
        "n_processed": 1,
        "n_failed": 1,
        "n_frames": 3,
        "n_segments": 3,
    }
    columns = "command, exit_code, n_processed, n_skipped, n_failed, finished_at > started_at AS ended"
    assert json.loads(run("query", f"SELECT {columns} FROM runs", "--format", "json").out) == [
        {
            "command": "process",
            "exit_code": 1,
            "n_processed": 1,
            "n_skipped": 0,
            "n_failed": 1,
            "ended": True,
        }
    ]
    assert run("runs").out.splitlines()[1].split()[1:2] == ["process"]


def test_a_store_of_a_newer_version_exits_12(run: Callable[..., Outcome], tmp_path: Path) -> None:
    make_recording(tmp_path / "a.mcap", shots(1))
    run("process", "a.mcap")
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


@pytest.mark.parametrize(
    ("write", "schema", "name"),
    [
        ("copy", "ros2msg", "annotated.mcap"),
        ("sidecar", "protobuf", "annotations.mcap"),
        ("none", "protobuf", None),
    ],
)
def test_where_annotations_go(
    run: Callable[..., Outcome], tmp_path: Path, write: str, schema: str, name: str | None
) -> None:
    make_recording(tmp_path / "a.mcap", shots(3))
    outcome = run("process", "a.mcap", "--write", write, "--schema", schema, "--json")
    result = json.loads(outcome.out)
    folder = tmp_path / "store" / "flights" / result["flight_id"][:16]
    assert result["annotated"] == (f"{folder}/{name}" if name else None)
    assert {path.name for path in folder.glob("*.mcap")} == {"review.mcap", *([name] if name else [])}
    assert "frame 2 of" in run("overlay", result["flight_id"], "-o", "o.png").out
    if name:
        shown = run("info", folder / name).out
        kind = {"protobuf": "(lsnet.Detections, protobuf)", "ros2msg": "(lsnet_msgs/msg/Detections, cdr)"}
        assert f"lsnet/detections: 3 messages {kind[schema]}" in shown
        assert json.loads(run("process", folder / name, "--json").out)["reason"] == "it is an annotated copy"
    else:
        (tmp_path / "a.mcap").write_bytes(b"something else")
        assert run("overlay", result["flight_id"], "-o", "o.png").exit_code == 1


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
    "arguments",
    [
        ["process"],
        ["proces", "a.mcap"],
        ["process", "a.mcap", "--every", "0"],
        ["process", "a.mcap", "--start", "yesterday"],
        ["process", "a.mcap", "--start", "20", "--end", "20"],
        ["process", "a.mcap", "--ground-alt", "nan"],
        ["process", "a.mcap", "--scale", "nan"],
        ["simulate", "a.mcap", "--size", "big"],
        ["simulate", "a.mcap", "--size", "100000x100000"],
        ["simulate", "a.mcap", "--fps", "inf"],
        ["simulate", "a.mcap", "--fault", "gremlins"],
        ["query", "SELECT 1", "--format", "xml"],
        ["query", "SELECT 1", "--timeout", "inf"],
        ["query", "SELECT 1", "--show-sql"],
        ["query", "--named", "gaps", "--param", "flight"],
        ["schedule", "inbox", "--print", "cron", "-o", "units"],
        ["schedule", "inbox", "--print", "systemd", "--user", "kim\nExecStart=rm"],
        ["overlay", "ab", "-o", "o.txt"],
        ["overlay", "-o", "o.png"],
        ["overlay", "ab", "--anomaly", "cd", "-o", "o.png"],
        ["pack", "inbox", "o.mp4"],
        ["simulate", "o.bag"],
        ["query", "SELECT 1", "-o", "o.xml"],
        ["query", "SELECT 1", "-o", "o.csv", "--format", "json"],
        ["query", "SELECT 1", "--named", "flights"],
        ["query", "-f", "none.sql"],
        ["query", " "],
        ["query", "SELECT 1", "-o", ""],
        ["overlay", "last", "-o", ""],
        ["flights", "list", "--store", ""],
        ["flights", "list", "--timezone", "Mars/Olympus"],
    ],
)
def test_wrong_usage_exits_2_in_plain_text(run: Callable[..., Outcome], arguments: list[str]) -> None:
    outcome = run(*arguments)
    assert (outcome.exit_code, outcome.out) == (2, "")
    assert "Error: " in outcome.err
    assert outcome.err.isascii()


@pytest.mark.parametrize("command", HELP)
def test_help_has_an_example(run: Callable[..., Outcome], command: str) -> None:
    outcome = run(*command.split(), "--help")
    assert (outcome.exit_code, outcome.err) == (0, "")
    assert re.search(rf"^(  Example: |    )lsnet-pipe {command}", outcome.out, re.MULTILINE)
    assert not re.search(r"\w\.\.\.$", outcome.out, re.MULTILINE)  # no sentence is cut
    assert run(*command.split(), "-h").out == outcome.out
    assert outcome.out.isascii()


def test_version(run: Callable[..., Outcome]) -> None:
    assert run("--version").out.startswith("lsnet-pipe 0.")


def test_info(run: Callable[..., Outcome], tmp_path: Path) -> None:
    make_recording(tmp_path / "a.mcap", shots(3))
    out = run("info", "a.mcap").out
    assert "/camera/image/compressed: 3 messages (foxglove.CompressedImage, protobuf)" in out
    assert "/gps: 6 messages (Gps, json)" in out
    assert "2023-11-14 22:13:20 to 2023-11-14 22:13:21 UTC" in out
    assert out.splitlines()[-1].split() == ["process", "/camera/image/compressed"]
    run("process", "a.mcap")
    (copy,) = tmp_path.rglob("annotated.mcap")
    assert "nothing: this is an annotated copy" in run("info", copy).out


def test_doctor(run: Callable[..., Outcome], tmp_path: Path) -> None:
    outcome = run("doctor")
    assert outcome.exit_code == 0
    assert "none yet" in outcome.out
    make_recording(tmp_path / "a.mcap", shots(2))
    run("process", "a.mcap")
    assert "1 flight, 0 damaged" in run("doctor").out
    (tmp_path / "store" / "index.duckdb").unlink()
    outcome = run("doctor")
    assert outcome.exit_code == 1
    assert "lsnet-pipe index rebuild" in outcome.out
    assert run("doctor", "--store", "a.mcap").exit_code == 1


def test_overlay(run: Callable[..., Outcome], tmp_path: Path) -> None:
    make_recording(tmp_path / "a.mcap", shots(3))
    flight = json.loads(run("process", "a.mcap", "--json").out)["flight_id"]
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


def test_overlays_of_all_frames(run: Callable[..., Outcome], tmp_path: Path) -> None:
    make_recording(tmp_path / "a.mcap", shots(3))
    flight = json.loads(run("process", "a.mcap", "--json").out)["flight_id"]
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


@pytest.mark.parametrize(
    ("number", "exit_code"),
    [pytest.param(signal.SIGINT, 130, marks=pytest.mark.slow), (signal.SIGTERM, 143)],
)
def test_interrupted_after_a_clean_stop(tmp_path: Path, number: signal.Signals, exit_code: int) -> None:
    """The detector of this child waits until it is stopped."""
    make_recording(tmp_path / "a.mcap", shots(20))
    program = (
        "import sys, time, fakes, lsnet, cli\n"
        "fakes.FakeDetector.detect = lambda self, images: [time.sleep(1) for _ in range(60)]\n"
        "lsnet.Detector = fakes.FakeDetector\n"
        "cli.main()"
    )
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).with_name("helpers"))}
    command = [sys.executable, "-c", program, "process", "a.mcap", "--store", "store"]
    child = subprocess.Popen(command, cwd=tmp_path, env=environment, stderr=subprocess.PIPE)
    staging = tmp_path / "store" / "staging"
    while child.poll() is None and not list(staging.glob("*/annotated.mcap")):
        time.sleep(0.05)
    child.send_signal(number)
    _, message = child.communicate(timeout=30)
    word = b"interrupted" if number == signal.SIGINT else b"terminated"
    assert (child.returncode, message) == (exit_code, b"stopped: " + word + b"\n")
    assert [path.name for path in staging.iterdir()] == ["mutex"]


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


def test_a_result_without_frames_replaces_none_with_frames(
    run: Callable[..., Outcome], tmp_path: Path
) -> None:
    make_recording(tmp_path / "a.mcap", shots(3))
    run("process", "a.mcap")
    later = ("process", "a.mcap", "--start", "2030-01-01", "--json")
    for force in ((), ("--force",)):
        outcome = run(*later, *force)
        assert (outcome.exit_code, outcome.out) == (1, "")
        assert "has 3 in the store, which stay" in outcome.err
        assert outcome.err.endswith("(--yes replaces them)\n")
    count = ("query", "SELECT count(*) AS n FROM frames", "--format", "csv")
    assert run(*count).out == "n\n3\n"
    outcome = run(*later, "--yes")
    assert json.loads(outcome.out)["n_frames_replaced"] == 3
    assert "this result of 0 frames replaces one of 3 frames" in outcome.err
    assert run(*count).out == "n\n0\n"


def test_process_reads_options_from_a_file(run: Callable[..., Outcome], tmp_path: Path) -> None:
    make_recording(tmp_path / "a.mcap", shots(9))
    (tmp_path / "p.toml").write_text('every = 4\nwrite = "none"\n')
    assert json.loads(run("process", "a.mcap", "--config", "p.toml", "--json").out)["n_frames"] == 3
    (tmp_path / "p.toml").write_text("evry = 4\n")
    assert run("process", "a.mcap", "--config", "p.toml").exit_code == 2


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


def test_lists_that_are_empty_say_so(run: Callable[..., Outcome], tmp_path: Path) -> None:
    make_recording(tmp_path / "a.mcap", shots(3))
    run("process", "a.mcap")
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
    run: Callable[..., Outcome], tmp_path: Path
) -> None:
    make_recording(tmp_path / "a.mcap", shots(1))
    run("process", "a.mcap")
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
