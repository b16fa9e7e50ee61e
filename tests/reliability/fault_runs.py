"""Commands on a disk that fails, one change of it after the other; run with faults.so preloaded.

Arguments: a folder, the command, how the disk fails, the step between the changes that fail. Each run is a
fork, and is followed by one on a good disk. Prints how many runs there were, and what they said, as JSON.
"""

from __future__ import annotations

import io
import json
import mmap
import os
import shutil
import signal
import struct
import sys
from collections import Counter
from contextlib import redirect_stderr, redirect_stdout, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import driver
from factories import make_recording, shots
from fakes import FakeDetector
from stores import check_visible, contents, file_names
from stubs import InlineExecutor, MakeStub

import cli
import lsnet
from inspect_pipeline.batch import local as executor_local
from inspect_pipeline.batch import options, stop_request, worker
from inspect_pipeline.batch.local import LocalExecutor
from inspect_pipeline.store.store import Store

if TYPE_CHECKING:
    from collections.abc import Callable

    from inspect_pipeline.batch.worker import Job

HOW = {"good": 0, "full": 1, "broken": 2, "short": 3}  # as in faults.c
TIMEOUT_S = 120


class Disk:
    """Write the settings of faults.so, and read its report."""

    def __init__(self, path: str) -> None:
        with Path(path).open("r+b") as file:
            self._numbers = mmap.mmap(file.fileno(), 32)

    def fail_at(self, number: int, how: str) -> None:
        self._numbers[:] = struct.pack("=4q", 0, number, HOW[how], 0)

    def counts(self) -> tuple[int, int]:
        """How many changes there were, and how many of them failed."""
        n_changes, _, _, n_failed = struct.unpack("=4q", self._numbers[:])
        return n_changes, n_failed


class _Worker(LocalExecutor):
    """One worker process with a stub; a fork, since starting interpreters is not what is tested."""

    def __init__(self, job: Job, **options: object) -> None:
        super().__init__(job, **options | {"n_workers": 1})
        executor_local.subprocess.Popen = driver.fork_worker


def prepare(folder: Path, command: str) -> None:
    """Put stubs in the place of detectors, and, but for `workers`, of worker processes."""
    lsnet.Detector = FakeDetector
    worker.LoadDetector = lambda weights, *_, **__: MakeStub(folder, weights)
    options.LocalExecutor = _Worker if command == "workers" else InlineExecutor
    stop_request._POLL_S = 0.05


def set_arguments(command: str, inbox: Path, store: Store, weights: str) -> None:
    """Those of the command line."""
    recordings = sorted(inbox.iterdir()) if command == "process" else [inbox]
    more = [] if command == "process" else ["--settle", "0", "--log-format", "json"]
    name = "process" if command == "process" else "batch"
    sys.argv = ["lsnet-pipe", name, *map(str, recordings), "--store", str(store.root), "--weights", weights]
    sys.argv += more


def warm_up(folder: Path, command: str, inbox: Path) -> None:
    """Have what a command imports imported once, before the forks."""
    set_arguments(command, inbox, Store(folder / "warm"), "first")
    nowhere = io.StringIO()
    with redirect_stdout(nowhere), redirect_stderr(nowhere), suppress(SystemExit):
        cli.main()


def run(
    command: str,
    inbox: Path,
    store: Store,
    weights: str,
    messages: Path,
    begin: Callable[[], object] = lambda: None,
) -> int:
    """The exit code of a command in a fork, where `begin` is called first; what it says is in `messages`."""
    set_arguments(command, inbox, store, weights)
    child = os.fork()
    if child == 0:
        signal.alarm(TIMEOUT_S)
        out = os.open(messages, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(out, 1)
        os.dup2(out, 2)
        code = 99
        try:
            begin()
            cli.main()
        except SystemExit as ended:
            code = int(ended.code or 0)
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(code)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def main() -> None:
    """Let every change fail in turn."""
    folder, command, how, step = Path(sys.argv[1]), sys.argv[2], sys.argv[3], int(sys.argv[4])
    prepare(folder, command)
    disk = Disk(os.environ["FAULT_CONTROL"])
    stores, inbox, messages = folder / "stores", folder / "inbox", folder / "messages"
    inbox.mkdir()
    make_recording(inbox / "a.mcap", shots(3))
    go = partial(run, command, inbox, messages=messages)

    warm_up(folder, command, inbox)
    before = Store(folder / "before")
    assert go(before, "first") == 0, messages.read_text()
    make_recording(inbox / "b.mcap", shots(2))
    after = Store(stores / "undisturbed")
    shutil.copytree(before.root, after.root)
    disk.fail_at(0, how)
    assert go(after, "second") == 0, messages.read_text()
    n_changes, _ = disk.counts()
    wanted = contents(after), file_names(after)

    endings: Counter[str] = Counter()
    for number in range(1, n_changes + 1, step):
        store = Store(stores / f"{number}")
        shutil.copytree(before.root, store.root)
        disk.fail_at(number, how)
        exit_code = go(store, "second")
        _, n_failed = disk.counts()
        said = messages.read_text()
        disk.fail_at(0, "good")
        where = f"change {number} of {n_changes}, exit code {exit_code}: {said}"
        assert exit_code in ((0,) if how == "short" else (0, 1)), where
        assert "Traceback" not in said, where
        try:
            check_visible(store)
            assert go(store, "second") == 0, messages.read_text()
            assert (contents(store), file_names(store)) == wanted
        except Exception:
            print(where, file=sys.stderr)
            raise
        endings[f"exit code {exit_code}" if n_failed else "not met"] += 1
        shutil.rmtree(store.root)
    print(json.dumps({"n_changes": n_changes, **endings}))


if __name__ == "__main__":
    main()
