"""Workers that are processes of this machine.

ProcessPoolExecutor loses every pending recording with the first killed worker; these are independent.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from multiprocessing.connection import wait
from typing import TYPE_CHECKING, Any

from inspect_pipeline.batch.executor import POLL_S, START_S, Executor, Worker, signals_blocked
from inspect_pipeline.batch.worker import LoadDetector, WorkerFailure
from inspect_pipeline.errors import DetectorError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from inspect_pipeline.batch.worker import Job
    from inspect_pipeline.store.records import RunRecord

_STDERR = 2  # native libraries may print in a worker, which must not reach stdout


class _Process(Worker):
    """A child process with a pipe to it."""

    def __init__(self, job: Job) -> None:
        super().__init__()
        self.connection, theirs = multiprocessing.Pipe()
        arguments = [str(theirs.fileno()), str(os.getpid())]
        with theirs, signals_blocked():  # their end is closed here, so that the pipe ends with the worker
            self._process = subprocess.Popen(
                [
                    sys.executable,
                    "-P",
                    "-c",
                    "from inspect_pipeline.batch.worker import main; main()",
                    *arguments,
                ],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=_STDERR,
            )
        with suppress(OSError):  # it has died, as its first message reports
            self.connection.send(sys.path)
            self.connection.send(job)
        self.deadline = time.monotonic() + START_S

    def _send(self, path: Path, run: RunRecord) -> bool:
        try:
            self.connection.send((path, run))
        except OSError:
            return False
        return True

    def receive(self) -> Any:
        """Return the waiting message, or a WorkerFailure when the pipe has ended."""
        try:
            return self.connection.recv()
        except (EOFError, OSError):
            return WorkerFailure("killed", _explain_exit(self._process.wait()))

    def kill(self) -> None:
        """End the process; it is gone afterwards."""
        self._process.kill()
        self._process.wait()
        self.connection.close()


class LocalExecutor(Executor[_Process]):
    """Runs up to `n_workers` processes."""

    def describe(self) -> Mapping[str, str | int | float]:
        """Return what the detector says about itself, without a worker where possible."""
        if self._description is None and isinstance(self._job.make_detector, LoadDetector):
            self._description = self._job.make_detector.describe()
        return super().describe()

    def _start_worker(self) -> _Process:
        try:
            return _Process(self._job)
        except OSError as error:
            why = error.strerror or error
            raise DetectorError(f"no worker can start ({why}); run lsnet-pipe doctor") from error

    def _with_message(self) -> list[_Process]:
        ready = wait([worker.connection for worker in self._workers], timeout=POLL_S)
        return [worker for worker in self._workers if worker.connection in ready]


def _explain_exit(exit_code: int) -> str:
    if exit_code >= 0:
        return f"the worker ended with exit code {exit_code}"
    try:
        name = signal.Signals(-exit_code).name
    except ValueError:  # a real-time signal
        name = str(-exit_code)
    hint = "; is there enough memory?" if exit_code == -signal.SIGKILL else ""
    return f"the worker was ended by {name}{hint}"
