"""Recordings through worker processes of this machine: one at a time each, supervised, replaced when killed.

A pool of concurrent.futures loses every waiting recording with the first killed worker; here one recording
takes down at most the worker it is in.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections import deque
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import chain
from multiprocessing.connection import wait
from typing import TYPE_CHECKING, Any, Self

from inspect_pipeline.errors import DetectorError, StoreError
from inspect_pipeline.types import ProcessResult
from inspect_pipeline.worker import Failure, Ready

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping
    from types import TracebackType

    from inspect_pipeline.flight import RunRecord
    from inspect_pipeline.inbox import Candidate
    from inspect_pipeline.worker import Job

_POLL_S = 0.5  # how soon a stop or a late worker is noticed
_MAX_FAILED_STARTS = 3
_STDERR = 2  # what native libraries print in a worker is no result


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of a recording: its result, or the failure of the last of its `attempts`."""

    candidate: Candidate
    attempts: int
    seconds: float
    result: ProcessResult | Failure


@dataclass(frozen=True, slots=True)
class _Task:
    candidate: Candidate
    attempts: int = 0
    seconds: float = 0.0


class LocalExecutor:
    """Up to `n_workers` workers for a job; all of them are gone after the `with` block.

    timeout_s: of one attempt at a recording; max_attempts: before it is given up;
    should_stop: asked twice a second, true ends `run` with what is under way dropped.
    """

    def __init__(
        self,
        job: Job,
        *,
        n_workers: int,
        timeout_s: float,
        max_attempts: int,
        should_stop: Callable[[], bool] = lambda: False,
    ) -> None:
        self._job, self._should_stop = job, should_stop
        self._n_workers, self._timeout_s, self._max_attempts = n_workers, timeout_s, max_attempts
        self._workers: list[_Worker] = []
        self._description: Mapping[str, str | int | float] | None = None
        self._n_failed_starts = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for worker in self._workers:
            worker.kill()
        self._workers.clear()

    def describe(self) -> Mapping[str, str | int | float]:
        """What the detector says about itself, {} when stopped before; raises DetectorError."""
        while self._description is None and not self._should_stop():
            if not self._workers:
                self._workers.append(_Worker(self._job))
            for worker, message in self._messages():
                self._settle(worker, message)
        return self._description or {}

    def run(self, candidates: Iterable[Candidate], run: RunRecord) -> Iterator[Outcome]:
        """The outcome of each recording, in the order they end.

        Raises DetectorError when no worker can start, StoreError when the store cannot be written.
        """
        queue = deque(_Task(candidate) for candidate in candidates)
        while (queue or any(worker.task for worker in self._workers)) and not self._should_stop():
            self._assign(queue, run)
            for worker, message in chain(self._messages(), self._late()):
                task, result = self._settle(worker, message)
                if task is None or result is None:
                    continue
                is_final = isinstance(result, ProcessResult) or result.reason == "unreadable"
                if is_final or task.attempts >= self._max_attempts:
                    yield Outcome(task.candidate, task.attempts, task.seconds, result)
                else:
                    queue.append(task)

    def _assign(self, queue: deque[_Task], run: RunRecord) -> None:
        """Give a recording to every worker that is free, and start workers for the others."""
        for worker in self._workers:
            if queue and worker.is_free and worker.give(queue[0], run, self._timeout_s):
                queue.popleft()
        n_coming = sum(not worker.is_ready for worker in self._workers)
        n_wanted = min(self._n_workers - len(self._workers), len(queue) - n_coming)
        self._workers += [_Worker(self._job) for _ in range(n_wanted)]

    def _messages(self) -> list[tuple[_Worker, Any]]:
        """What workers have sent, a Failure for each that has died; waits a little for the first."""
        by_connection = {worker.connection: worker for worker in self._workers}
        ready = wait(list(by_connection), timeout=_POLL_S)
        return [(worker, worker.receive()) for worker in self._workers if worker.connection in ready]

    def _late(self) -> Iterator[tuple[_Worker, Any]]:
        """A Failure for each worker whose time is up."""
        for worker in list(self._workers):
            if worker.task and time.monotonic() >= worker.deadline:
                yield worker, Failure("timeout", f"not done after {self._timeout_s:g} s")

    def _settle(self, worker: _Worker, message: Any) -> tuple[_Task | None, ProcessResult | Failure | None]:
        """The recording that a message is about, with its result; both None when it is about the worker."""
        if isinstance(message, StoreError | DetectorError):
            raise message
        if isinstance(message, Ready):
            worker.is_ready, self._description, self._n_failed_starts = True, message.description, 0
            return None, None
        if isinstance(message, Failure) and message.reason in ("killed", "timeout"):
            worker.kill()
            self._workers.remove(worker)
            if not worker.is_ready:
                self._count_failed_start(message)
        return worker.take(), message

    def _count_failed_start(self, failure: Failure) -> None:
        self._n_failed_starts += 1
        if self._n_failed_starts >= _MAX_FAILED_STARTS:
            raise DetectorError(f"no worker can start ({failure.detail}); run lsnet-pipe doctor")


class _Worker:
    """A child process, and the recording it is at."""

    def __init__(self, job: Job) -> None:
        self.connection, theirs = multiprocessing.Pipe()
        arguments = [str(theirs.fileno()), str(os.getpid())]
        with theirs, _signals_blocked():  # our copy of their end is closed: when they end, the pipe does
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-c", "from inspect_pipeline.worker import main; main()", *arguments],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=_STDERR,
            )
        self.connection.send(sys.path)
        self.connection.send(job)
        self.is_ready = False
        self.task: _Task | None = None
        self.deadline = 0.0
        self._started = 0.0

    @property
    def is_free(self) -> bool:
        return self.is_ready and self.task is None

    def give(self, task: _Task, run: RunRecord, timeout_s: float) -> bool:
        """Start an attempt; False when the worker was killed while it was idle."""
        try:
            self.connection.send((task.candidate.path, run))
        except OSError:
            return False
        self.task, self._started = task, time.monotonic()
        self.deadline = self._started + timeout_s
        return True

    def take(self) -> _Task | None:
        """The task that has ended, one attempt the richer; the worker is free for another."""
        task, self.task = self.task, None
        if task is None:
            return None
        seconds = task.seconds + time.monotonic() - self._started
        return replace(task, attempts=task.attempts + 1, seconds=seconds)

    def receive(self) -> Any:
        """The message that waits in the pipe, or a Failure when the pipe has ended."""
        try:
            return self.connection.recv()
        except (EOFError, OSError):
            return Failure("killed", _explain_exit(self._process.wait()))

    def kill(self) -> None:
        """End the process, whatever it is doing: the store is made for that."""
        self._process.kill()
        self._process.wait()
        self.connection.close()


@contextmanager
def _signals_blocked() -> Iterator[None]:
    """What a terminal or systemd sends to the whole group is for the parent: children inherit the mask."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _explain_exit(exit_code: int) -> str:
    if exit_code >= 0:
        return f"the worker ended with exit code {exit_code}"
    try:
        name = signal.Signals(-exit_code).name
    except ValueError:  # a real-time signal
        name = str(-exit_code)
    hint = "; is there enough memory?" if exit_code == -signal.SIGKILL else ""
    return f"the worker was ended by {name}{hint}"
