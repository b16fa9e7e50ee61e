"""The service that processes recordings for a batch, one at a time, and the child process that runs it.

It loads the detector once, writes flights into the store, and never opens the index.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import traceback
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING, Any, Literal, Protocol

from inspect_pipeline.errors import (
    DetectorError,
    EmptyResultError,
    NoImagesError,
    RecordingError,
    StoreError,
    TerrainError,
)
from inspect_pipeline.store.records import ProcessResult
from inspect_pipeline.store.store import Store

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from inspect_pipeline.config import ProcessOptions
    from inspect_pipeline.store.records import RunRecord
    from lsnet import Detector

_PR_SET_PDEATHSIG = 1
_TRACEBACK_FRAMES = 12


class DetectorFactory(Protocol):
    """Creates the detector in the worker; picklable."""

    def __call__(self) -> Detector: ...


@dataclass(frozen=True, slots=True)
class LoadDetector:
    """Load the detector that the options of the batch ask for."""

    weights: str
    scale: float | None = None
    min_score: float | None = None
    runtime: str = "auto"
    threads: int | None = None  # of the CPU, for this worker; not part of the description

    def describe(self) -> dict[str, str | int | float] | None:
        """Return the description of the detector, or None if it must be loaded for that."""
        from lsnet.description import describe_detector  # noqa: PLC0415

        return describe_detector(
            self.weights, runtime=self.runtime, scale=self.scale, min_score=self.min_score
        )

    def __call__(self) -> Detector:
        from lsnet import Detector, LSNetError  # noqa: PLC0415 - the parent does without torch

        try:
            return Detector.load(
                self.weights,
                runtime=self.runtime,
                threads=self.threads,
                scale=self.scale,
                min_score=self.min_score,
            )
        except LSNetError as error:
            raise DetectorError(str(error)) from error


def threads_of(n_workers: int) -> int:
    """Return the share of each worker of the cores that this process may use."""
    return max(1, len(os.sched_getaffinity(0)) // n_workers)


@dataclass(frozen=True, slots=True)
class Job:
    """What all recordings of a batch have in common."""

    store_root: Path
    options: ProcessOptions
    make_detector: DetectorFactory


@dataclass(frozen=True, slots=True)
class Ready:
    """The first message of a worker: the description of its detector."""

    description: Mapping[str, str | int | float]


@dataclass(frozen=True, slots=True)
class WorkerFailure:
    """Why a recording has no result.

    unreadable: refused, as any further attempt would be; error: an unexpected exception; killed: the worker
    died; timeout: it took too long.
    """

    reason: Literal["unreadable", "error", "killed", "timeout"]
    detail: str


class Service:
    """A detector, and the store its flights go to; raises DetectorError when it cannot be loaded."""

    def __init__(self, job: Job) -> None:
        from inspect_pipeline.pipeline import process  # noqa: PLC0415 - the parent does without OpenCV

        self._detector = job.make_detector()
        self._store, self._options, self._process = Store(job.store_root), job.options, process

    def ready(self) -> Ready:
        """Return the first message."""
        return Ready(self._detector.describe())

    def process(
        self, path: Path, run: RunRecord
    ) -> ProcessResult | WorkerFailure | StoreError | TerrainError:
        """Process a recording; errors about the store or the terrain model are returned as they are.

        A recording of telemetry only is skipped: its result has no flight_id.
        """
        try:
            return self._process(path, self._store, self._detector, self._options, run)
        except (StoreError, TerrainError) as error:
            return error
        except NoImagesError as error:
            return ProcessResult("", str(path), "skipped", None, 0, 0, 0, 0.0, reason=error.problem)
        except (EmptyResultError, RecordingError) as error:
            return WorkerFailure("unreadable", str(error))
        except Exception:  # which must not end the other recordings
            return WorkerFailure("error", traceback.format_exc(limit=-_TRACEBACK_FRAMES))


def main() -> None:
    """Serve the parent, and die with it; the arguments are the descriptor of the pipe and the parent's pid.

    Its sys.path and a Job arrive first; a Ready is the answer, or the DetectorError that prevents it.
    Then each (path, run) is answered.
    """
    descriptor, parent_pid = map(int, sys.argv[1:])
    _die_with(parent_pid)
    connection: Connection[Any, Any] = Connection(descriptor)
    sys.path[:] = connection.recv()
    job = connection.recv()
    try:
        service = Service(job)
    except DetectorError as error:
        connection.send(error)
        return
    connection.send(service.ready())
    while True:
        try:
            path, run = connection.recv()
        except (EOFError, OSError):  # the parent has died
            return
        connection.send(service.process(path, run))


def _die_with(parent_pid: int) -> None:
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent_pid:  # it died before prctl
        os._exit(1)
