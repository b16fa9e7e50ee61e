"""Supervised workers, each with one recording at a time: timed, and replaced when they die.

A recording takes down at most its own worker, and is tried again. Subclasses decide what a worker is: a
process of this machine or an actor of a cluster.
"""

from __future__ import annotations

import math
import signal
import time
from abc import ABC, abstractmethod
from collections import deque
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import chain
from typing import TYPE_CHECKING, Any, Generic, Self, TypeVar

from inspect_pipeline.batch.worker import Ready, WorkerFailure
from inspect_pipeline.errors import DetectorError, InspectError
from inspect_pipeline.store.records import ProcessResult

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping
    from pathlib import Path
    from types import TracebackType

    from inspect_pipeline.batch.inbox import Candidate
    from inspect_pipeline.batch.worker import Job
    from inspect_pipeline.store.records import RunRecord

POLL_S = 0.5  # how soon a stop or a late worker is noticed
START_S = 300.0  # for a free CPU, an interpreter and a detector
_MAX_FAILED_STARTS = 3


@dataclass(frozen=True, slots=True)
class Outcome:
    """The result of a recording, or the failure of the last of its `attempts`."""

    candidate: Candidate
    attempts: int
    seconds: float
    result: ProcessResult | WorkerFailure


@dataclass(frozen=True, slots=True)
class _Task:
    candidate: Candidate
    attempts: int = 0
    seconds: float = 0.0


class Worker(ABC):
    """A worker and the task it is working on. Its first message is a Ready."""

    def __init__(self) -> None:
        self.is_ready = False
        self.task: _Task | None = None
        self.deadline = math.inf
        self._started = 0.0

    @abstractmethod
    def _send(self, path: Path, run: RunRecord) -> bool:
        """Start on a recording; False when the worker has died, as its next message reports."""

    @abstractmethod
    def receive(self) -> Any:
        """Return the waiting message, or a WorkerFailure "killed" when the worker has died."""

    @abstractmethod
    def kill(self) -> None:
        """End it at once, whatever it is doing; the store allows that."""

    @property
    def is_free(self) -> bool:
        """Whether it waits for a recording."""
        return self.is_ready and self.task is None

    def give(self, task: _Task, run: RunRecord, timeout_s: float) -> bool:
        """Start an attempt; False when the worker was killed while it was idle."""
        if not self._send(task.candidate.path, run):
            return False
        self.task, self._started = task, time.monotonic()
        self.deadline = self._started + timeout_s
        return True

    def take(self) -> _Task | None:
        """Return the ended task with its attempts counted; the worker is free again."""
        task, self.task, self.deadline = self.task, None, math.inf
        if task is None:
            return None
        seconds = task.seconds + time.monotonic() - self._started
        return replace(task, attempts=task.attempts + 1, seconds=seconds)


AnyWorker = TypeVar("AnyWorker", bound=Worker)


class Executor(ABC, Generic[AnyWorker]):
    """Runs up to `n_workers` workers for a job; all of them have ended after the `with` block.

    timeout_s: time limit of one attempt at a recording; max_attempts: before it is given up; should_stop:
    polled twice a second, true ends `run` and drops unfinished recordings.
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
        self._workers: list[AnyWorker] = []
        self._description: Mapping[str, str | int | float] | None = None
        self._n_failed_starts = 0

    @abstractmethod
    def _start_worker(self) -> AnyWorker:
        """Start another worker; raises DetectorError when that is impossible."""

    @abstractmethod
    def _with_message(self) -> list[AnyWorker]:
        """Return the workers with a waiting message, after up to POLL_S for the first."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for worker in self._workers:
            worker.kill()
        self._workers.clear()

    def describe(self) -> Mapping[str, str | int | float]:
        """Return the description of the detector, {} when stopped before; raises DetectorError."""
        while self._description is None and not self._should_stop():
            try:
                if not self._workers:
                    self._workers.append(self._start_worker())
            except DetectorError:
                if self._should_stop():
                    break
                raise
            for worker, message in chain(self._messages(), self._late()):
                self._settle(worker, message)
        return self._description or {}

    def run(self, candidates: Iterable[Candidate], run: RunRecord) -> Iterator[Outcome]:
        """Yield the outcome of each recording, in the order they end.

        Raises DetectorError when no worker can start, StoreError when the store cannot be written,
        TerrainError when the terrain model is gone.
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
        """Give a recording to every free worker, and start workers for the others."""
        for worker in self._workers:
            if queue and worker.is_free and worker.give(queue[0], run, self._timeout_s):
                queue.popleft()
        n_coming = sum(not worker.is_ready for worker in self._workers)
        n_wanted = min(self._n_workers - len(self._workers), len(queue) - n_coming)
        self._workers += [self._start_worker() for _ in range(n_wanted)]

    def _messages(self) -> list[tuple[AnyWorker, Any]]:
        """Return the messages of workers, a WorkerFailure for each that has died."""
        return [(worker, worker.receive()) for worker in self._with_message()]

    def _late(self) -> Iterator[tuple[AnyWorker, WorkerFailure]]:
        """Yield each worker past its deadline; one may still be starting while others are ready."""
        for worker in list(self._workers):
            if time.monotonic() < worker.deadline:
                continue
            if worker.task:
                yield worker, WorkerFailure("timeout", f"not done after {self._timeout_s:g} s")
            elif not any(other.is_ready for other in self._workers):
                yield worker, WorkerFailure("timeout", "not ready in time")

    def _settle(
        self, worker: AnyWorker, message: Any
    ) -> tuple[_Task | None, ProcessResult | WorkerFailure | None]:
        """Return the recording of a message and its result; both None for a message about the worker."""
        if isinstance(message, InspectError):
            raise message
        if isinstance(message, Ready):
            self._welcome(worker, message)
            return None, None
        if isinstance(message, WorkerFailure) and message.reason in ("killed", "timeout"):
            worker.kill()
            self._workers.remove(worker)
            if not worker.is_ready:
                self._count_failed_start(message)
        return worker.take(), message

    def _welcome(self, worker: AnyWorker, message: Ready) -> None:
        """Accept a worker; raises DetectorError when its detector differs from that of the others."""
        known = self._description or message.description
        for name in known.keys() | message.description.keys():
            ours, theirs = known.get(name), message.description.get(name)
            if ours != theirs:
                raise DetectorError(
                    f"workers differ in {name}, {ours} and {theirs}; use machines and packages of one kind"
                )
        worker.is_ready, worker.deadline = True, math.inf
        self._description, self._n_failed_starts = message.description, 0

    def _count_failed_start(self, failure: WorkerFailure) -> None:
        self._n_failed_starts += 1
        if self._n_failed_starts >= _MAX_FAILED_STARTS:
            raise DetectorError(f"no worker can start ({failure.detail}); run lsnet-pipe doctor")


@contextmanager
def signals_blocked() -> Iterator[None]:
    """Block the signals that a terminal or systemd sends to the whole group; children inherit the mask."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
