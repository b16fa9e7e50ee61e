"""The command line in a real shell: pipes, signals, completion, and how fast it answers."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from factories import make_recording, shots
from flights import write_flight

from inspect_pipeline.index.publish import publish
from inspect_pipeline.store.store import Store

PROGRAM = f"{sys.executable} -c 'import cli; cli.main()'"


def shell(line: str, folder: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run a line of bash, where `lsnet-pipe` is the program; the code is that of its first command."""
    line = line.replace("lsnet-pipe", PROGRAM)
    command = ["bash", "-c", f"{line}; exit ${{PIPESTATUS[0]}}"]
    inherited = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2]), "PYTHONWARNINGS": "ignore"}
    return subprocess.run(
        command, cwd=folder, env=inherited | environment, capture_output=True, text=True, check=False
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a store of one flight."""
    folder = tmp_path_factory.mktemp("shell")
    store = Store(folder / "inspections")
    write_flight(store, "one", 3)
    publish(store)
    return folder


@pytest.mark.parametrize("form", ["table", "csv", "json"])
def test_a_reader_that_has_seen_enough_is_no_error(folder: Path, form: str) -> None:
    done = shell(f'lsnet-pipe query "FROM range(60000)" --format {form} | head -1', folder)
    assert (done.returncode, done.stderr, done.stdout.count("\n")) == (0, "", 1)


def test_sql_from_stdin(folder: Path) -> None:
    for argument in ("-", ""):
        assert shell(f"echo 'SELECT 7 AS n' | lsnet-pipe query {argument} -o n.json", folder).stderr == ""
        assert json.loads((folder / "n.json").read_text()) == [{"n": 7}]
    assert shell("lsnet-pipe query < /dev/null", folder).returncode == 2


def test_a_stdout_that_cannot_be_written(folder: Path) -> None:
    for target in (">&-", "> /dev/full"):
        done = shell(f"lsnet-pipe flights list {target}", folder)
        assert done.returncode == 1
        assert done.stderr.startswith("error: ")
        assert done.stderr.count("\n") == 1


def test_an_output_that_is_a_pipe_is_written_through(folder: Path) -> None:
    """On a FIFO of its own: as root, a mistake with a device of the system would break the machine."""
    line = "mkfifo rows; cat rows > copy & lsnet-pipe query 'SELECT 5 AS n' --format csv -o rows && wait"
    assert shell(line, folder).returncode == 0
    assert (folder / "rows").is_fifo()
    assert (folder / "copy").read_text() == "n\n5\n"


def test_a_query_of_a_file_below_the_limits_of_the_shell(folder: Path) -> None:
    """The program's own limits are never above those of `ulimit`, which nobody but root may raise."""
    (folder / "q.sql").write_text("SELECT 8 AS n;")
    done = shell("ulimit -t 30; lsnet-pipe query -f q.sql --format csv", folder)
    assert (done.stdout, done.stderr) == ("n\n8\n", "")


def test_completion(folder: Path) -> None:
    done = shell(
        "lsnet-pipe",
        folder,
        _LSNET_PIPE_COMPLETE="complete_bash",
        COMP_WORDS="lsnet-pipe proc",
        COMP_CWORD="1",
    )
    assert done.stdout.split() == ["process"]
    shown = shell("lsnet-pipe --show-completion bash", folder)
    assert "complete -o default -F" in shown.stdout
    assert "COMP_WORDS" in shown.stdout


def test_a_stop_while_the_detector_loads(tmp_path: Path) -> None:
    """No abort in C++, no traceback, nothing left behind."""
    make_recording(tmp_path / "a.mcap", shots(2))
    program = "import cli, sys, time; sys.stderr.write('x'); sys.stderr.flush(); cli.main()"
    command = [sys.executable, "-c", program, "process", "a.mcap", "--store", "s", "--force"]
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    child = subprocess.Popen(command, cwd=tmp_path, env=environment, stderr=subprocess.PIPE, text=True)
    assert child.stderr
    assert child.stderr.read(1) == "x"
    time.sleep(0.7)
    child.send_signal(signal.SIGINT)
    _, printed = child.communicate(timeout=60)
    assert (child.returncode, printed) == (130, "stopped: interrupted\n")
    assert not list(tmp_path.glob("s/staging/*/*"))
