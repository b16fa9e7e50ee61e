"""The nightly commands as their users meet them."""

from __future__ import annotations

import json
import os
import sys
import time
import tomllib
from typing import TYPE_CHECKING

import pytest
from factories import make_recording, shots
from prometheus_client.parser import text_string_to_metric_families
from stubs import InlineExecutor, make_stub_in_cwd
from terrain import write_dem

from inspect_pipeline.batch import worker
from inspect_pipeline.store.store import Store

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from command_line import Outcome


@pytest.fixture
def run(
    run: Callable[..., Outcome], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> Callable[..., Outcome]:
    """Run `lsnet-pipe ...` in this process and a folder of its own, where recordings wait in ./inbox."""
    monkeypatch.setattr("inspect_pipeline.batch.options.LocalExecutor", InlineExecutor)
    monkeypatch.setattr(worker, "LoadDetector", make_stub_in_cwd)
    (tmp_path / "inbox").mkdir()
    for i in range(2):
        make_recording(tmp_path / "inbox" / f"r{i}.mcap", shots(2 + i))
    (tmp_path / "inbox" / "odd\n\x1b[2J.mcap").write_bytes(b"no recording")
    for path in (tmp_path / "inbox").iterdir():
        os.utime(path, (0, 0))
    return run


def test_a_night_as_people_see_it(run: Callable[..., Outcome], tmp_path: Path) -> None:
    night = run("batch", "inbox")
    assert night.exit_code == 3
    assert night.out.startswith("3 recordings: 2 processed, 0 done before, 1 in quarantine, 0 still being")
    assert f"{tmp_path}/inbox/r0.mcap: ok, 2 frames, 0 lines, " in night.err
    assert (
        "/inbox/odd??[2J.mcap: in quarantine after attempt 1, unreadable: it is not an MCAP file;"
        in night.err
    )
    assert "\x1b" not in night.err
    listed = run("quarantine", "list")
    assert listed.out.count("\n") == 2
    note_id = json.loads(run("quarantine", "list", "--json").out)["id"]
    assert listed.out.splitlines()[1].startswith(f"{note_id}  20")
    assert run("quarantine", "clear").out == ""
    assert run("quarantine", "retry", "xyz").exit_code == 1
    assert run("quarantine", "retry", note_id[:5]).out == f"{tmp_path}/inbox/odd??[2J.mcap\n"
    assert run("batch", "inbox").out.startswith("3 recordings: 0 processed, 2 done before, 1 in quarantine")
    (tmp_path / "inbox" / "odd\n\x1b[2J.mcap").unlink()
    assert "odd" in run("quarantine", "clear").out
    last = run("batch", "inbox", "--report")
    assert (last.exit_code, "reports: 2 pages written" in last.err) == (0, True)
    head, *nights = run("runs").out.splitlines()
    assert head.split()[:5] == ["started", "command", "duration_s", "exit", "processed"]
    assert [night.split()[3:5] for night in nights] == [["3", "2"], ["3", "0"], ["0", "0"]]
    assert json.loads(run("runs", "--json").out.splitlines()[0])["counts"]["n_processed"] == 2


def test_a_night_as_machines_see_it(run: Callable[..., Outcome], tmp_path: Path) -> None:
    hook = f"{sys.executable} -c \"import sys; open('summary', 'w').write(sys.stdin.read())\""
    options = ("--log-format", "json", "--metrics", "lsnet.prom", "--on-finish", hook, "--tag", "line=L12")
    night = run("batch", "inbox", *options)
    lines = [json.loads(line) for line in night.err.splitlines()]
    assert [line["event"] for line in lines][0::5] == ["batch started", "batch finished"]
    assert {line["level"] for line in lines} == {"info", "warning"}
    summary = json.loads((tmp_path / "summary").read_text())
    assert summary == json.loads((tmp_path / "store" / "summary.json").read_text())
    assert (summary["exit_code"], summary["tags"], summary["counts"]["n_frames"]) == (3, {"line": "L12"}, 5)
    families = text_string_to_metric_families((tmp_path / "lsnet.prom").read_text())
    values = {(s.name, *s.labels.values()): s.value for family in families for s in family.samples}
    assert values["lsnet_pipe_last_run_exit_code",] == 3
    assert time.time() - values["lsnet_pipe_last_success_timestamp_seconds",] < 60
    assert values["lsnet_pipe_recordings", "quarantined"] == values["lsnet_pipe_quarantine_size",] == 1
    assert values["lsnet_pipe_frames",] == 5


def test_options_from_a_file(run: Callable[..., Outcome], tmp_path: Path) -> None:
    (tmp_path / "night.toml").write_text(
        'inbox = ["inbox"]\nevery = 2\ntag = ["line=L12", "crew=b"]\nlimit = 1\nsince = 1970-01-01\n'
        'store = "elsewhere"\nstrict = true\n'
    )
    assert run("batch", "--config", "night.toml", "--limit", 2).exit_code == 3
    summary = json.loads((tmp_path / "elsewhere" / "summary.json").read_text())
    assert (summary["tags"], summary["config"]["every"]) == ({"line": "L12", "crew": "b"}, 2)
    assert summary["counts"]["n_left"] == 1
    for text, words in (
        ("evry = 2", "unknown option 'evry'"),
        ("every = ", "night.toml"),
        ("every = 0", "every"),
    ):
        (tmp_path / "night.toml").write_text(text)
        outcome = run("batch", "inbox", "--config", "night.toml")
        assert (outcome.exit_code, words in outcome.err) == (2, True)


def test_every_option_can_be_in_the_file(
    run: Callable[..., Outcome], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("inspect_pipeline.batch.options.RayExecutor", InlineExecutor)
    write_dem(tmp_path / "terrain.tif", (47.0, 3.0), lambda east, _: 0 * east)
    (tmp_path / "night.toml").write_text(
        """
        inbox = ["inbox"]
        store = "elsewhere"
        since = 1970-01-01T00:00:00Z
        dry-run = true
        limit = 2
        executor = "ray"
        jobs = 2
        timeout = 60
        max-attempts = 1
        settle = 0.5
        topic = ["/camera"]
        every = 2
        strict = true
        write = "none"
        schema = "protobuf"
        ground-alt = 120.5
        view = 80
        wire = 28.5
        dem = "terrain.tif"
        weights = "fast"
        scale = 0.5
        track-support = false
        min-score = 0.4
        runtime = "torch"
        tag = ["line=L12"]
        keep-annotated = 30
        metrics = "lsnet.prom"
        on-finish = "true"
        report = true
        log-format = "json"
        [signals]
        battery = "/battery.percentage"
        """
    )
    named = set(tomllib.loads((tmp_path / "night.toml").read_text()))
    outcome = run("batch", "--config", "night.toml")
    assert (outcome.exit_code, len(outcome.out.splitlines())) == (0, 2)
    (tmp_path / "night.toml").write_text("x = 1")
    known = run("batch", "--config", "night.toml").err.replace("\n", " ").rsplit("known are", 1)[1]
    assert set(known.replace(",", " ").split()) == named


def test_a_dry_run_writes_nothing(run: Callable[..., Outcome], tmp_path: Path) -> None:
    outcome = run("batch", "inbox/*", "--dry-run")
    assert (outcome.exit_code, len(outcome.out.splitlines())) == (0, 3)
    assert not (tmp_path / "store").exists()


@pytest.mark.parametrize(
    ("arguments", "exit_code", "words"),
    [
        (("nowhere",), 1, "nowhere: there is no such folder or file; check the name"),
        (("inbox", "--weights", "none"), 1, "error: no weights named 'none'"),
        (("inbox", "--executor", "ray"), 1, "error: Ray is not installed; pip install 'lsnet-pipe[ray]'"),
        (("inbox", "--timeout", "nan"), 2, "Invalid value for '--timeout'"),
        (("inbox", "--settle", "inf"), 2, "inf is not a finite number"),
        (("inbox", "--keep-annotated", "nan"), 2, "Invalid value for '--keep-annotated'"),
        (("inbox", "--keep-annotated", "1e9"), 2, "Invalid value for '--keep-annotated'"),
        (("inbox", "--tag", "L12"), 2, "'L12' is not of the form KEY=VALUE"),
        (
            ("inbox", "--on-finish", " "),
            1,
            "error:  : the command failed after the end of the batch (it is empty); check",
        ),
        (("inbox", "--on-finish", "false"), 1, "error: false: the command failed after the end"),
        (("inbox", "--metrics", "no/where.prom"), 1, "no/where.prom: the metrics cannot be written"),
    ],
)
def test_what_fails_is_reported(
    run: Callable[..., Outcome],
    monkeypatch: pytest.MonkeyPatch,
    arguments: tuple[str, ...],
    exit_code: int,
    words: str,
) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    outcome = run("batch", *arguments)
    assert outcome.exit_code == exit_code
    assert words in outcome.err
    assert "Traceback" not in outcome.err


def test_the_second_batch_names_the_first(run: Callable[..., Outcome], tmp_path: Path) -> None:
    with Store(tmp_path / "store").batch_lock():
        outcome = run("batch", "inbox")
    assert outcome.exit_code == 11
    assert f"pid {os.getpid()} since" in outcome.err
