"""A batch with a stub detector, in a process of its own that tests can kill; may be run as a script.

Arguments: inbox, store, folder for the notes of the stub, name of the weights, seconds per batch of images.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stubs import MakeStub

from inspect_pipeline.batch import local as executor_local
from inspect_pipeline.batch import worker
from inspect_pipeline.batch.options import BatchOptions
from inspect_pipeline.batch.run import run_batch
from inspect_pipeline.batch.stop_request import stop_on_signals
from inspect_pipeline.batch.worker import Job
from inspect_pipeline.config import ProcessOptions
from inspect_pipeline.pipeline import process  # noqa: F401 - so that forks have it
from inspect_pipeline.store.store import Store

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence


class Fork:
    """What the tests use of a Popen, of a fork that ends with the exit code of `run`."""

    def __init__(self, run: Callable[[], int]) -> None:
        self._exit_code: int | None = None
        self.pid = os.fork()
        if self.pid == 0:
            exit_code = 1
            try:
                exit_code = run()
            finally:
                os._exit(exit_code)

    def poll(self) -> int | None:
        if self._exit_code is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            self._exit_code = os.waitstatus_to_exitcode(status) if pid else None
        return self._exit_code

    def wait(self) -> int:
        while (exit_code := self.poll()) is None:
            time.sleep(0.01)
        return exit_code

    def kill(self) -> None:
        if self.poll() is None:
            os.kill(self.pid, signal.SIGKILL)


def run(inbox: str, root: str, notes: str, weights: str, delay_s: str) -> int:
    """The exit code of the batch."""
    store = Store(Path(root))
    job = Job(store.root, ProcessOptions(), MakeStub(Path(notes), weights, float(delay_s)))
    options = BatchOptions((inbox,), n_workers=2, max_attempts=10, settle_s=0)
    with stop_on_signals() as stop:
        return run_batch(store, job, options, lambda event, **fields: None, stop).exit_code


def start_forked(arguments: Sequence[str]) -> Fork:
    """The batch with workers that are forks too, where the start of interpreters is not what is tested."""

    def run_forked() -> int:
        executor_local.subprocess.Popen = fork_worker
        return run(*arguments)

    return Fork(run_forked)


def fork_worker(command: Sequence[str], *, pass_fds: Sequence[int], **_: Any) -> Fork:
    """In place of the Popen of a worker."""

    def serve() -> int:
        (kept,) = pass_fds
        os.closerange(3, kept)  # the locks of the batch are not to outlive it
        os.closerange(kept + 1, os.sysconf("SC_OPEN_MAX"))
        sys.argv = list(command[3:])
        worker.main()
        return 0

    return Fork(serve)


if __name__ == "__main__":
    sys.exit(run(*sys.argv[1:]))
