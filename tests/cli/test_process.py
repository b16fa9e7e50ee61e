"""`lsnet-pipe process`: what is printed, and what the index holds afterwards."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from factories import make_recording, shots
from fakes import FakeDetector

if TYPE_CHECKING:
    from collections.abc import Callable

    from command_line import Outcome

    from inspect_pipeline.store.store import Store


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


def test_process_then_query(run: Callable[..., Outcome], flight: str) -> None:
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


def test_process_continues_after_a_bad_recording(run: Callable[..., Outcome], tmp_path: Path) -> None:
    (tmp_path / "bad.mcap").write_bytes(b"no recording")
    make_recording(tmp_path / "good.mcap", shots(2))
    outcome = run("process", "bad.mcap", "good.mcap", "--json")
    assert (outcome.exit_code, json.loads(outcome.out)["status"]) == (1, "ok")
    assert outcome.err.startswith("error: bad.mcap: ")
    assert run("query", "SELECT count(*) AS n FROM flights", "--format", "csv").out.split() == ["n", "1"]


def test_process_continues_after_a_recording_that_vanishes(
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


@pytest.mark.parametrize(
    ("write", "schema", "name"),
    [
        ("copy", "ros2msg", "annotated.mcap"),
        ("sidecar", "protobuf", "annotations.mcap"),
        ("none", "protobuf", None),
    ],
)
def test_where_annotations_go(
    run: Callable[..., Outcome],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    write: str,
    schema: str,
    name: str | None,
) -> None:
    def make(_index: object, store: Store, flight_id: str) -> None:
        (store.flight_dir(flight_id) / "review.mcap").touch()

    monkeypatch.setattr("inspect_pipeline.publishing._makers", lambda: (make,))
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


def test_a_result_without_frames_replaces_none_with_frames(run: Callable[..., Outcome], flight: str) -> None:
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
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[1] / "helpers")}
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
