"""The child process that a batch gives recordings to, one at a time.

It loads the detector once, writes flights into the store, never opens the index, and dies with its parent.
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

from inspect_pipeline.errors import DetectorError, RecordingError, StoreError
from inspect_pipeline.store import Store

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from inspect_pipeline.config import ProcessOptions
    from lsnet import Detector

_PR_SET_PDEATHSIG = 1
_TRACEBACK_FRAMES = 12


class DetectorFactory(Protocol):
    """Makes the detector, in the worker; can be pickled."""

    def __call__(self) -> Detector: ...


@dataclass(frozen=True, slots=True)
class LoadDetector:
    """Loads the detector that the options of the command line ask for."""

    weights: str
    scale: float | None = None
    min_score: float | None = None

    def __call__(self) -> Detector:
        from lsnet import Detector, LSNetError  # noqa: PLC0415 - the parent does without torch

        try:
            return Detector.load(self.weights, scale=self.scale, min_score=self.min_score)
        except LSNetError as error:
            raise DetectorError(str(error)) from error


@dataclass(frozen=True, slots=True)
class Job:
    """What is the same for all recordings of a batch."""

    store_root: Path
    options: ProcessOptions
    make_detector: DetectorFactory


@dataclass(frozen=True, slots=True)
class Ready:
    """The first message of a worker: what its detector says about itself."""

    description: Mapping[str, str | int | float]


@dataclass(frozen=True, slots=True)
class Failure:
    """Why there is no result of a recording.

    unreadable: refused, as it would be again; error: a fault of the program; killed: the worker died;
    timeout: it took too long.
    """

    reason: Literal["unreadable", "error", "killed", "timeout"]
    detail: str


def main() -> None:
    """Serve the parent: the arguments are the number of the pipe's descriptor and the parent's pid.

    Its sys.path and a Job arrive first; a Ready is the answer, or the DetectorError that prevents it.
    """
    descriptor, parent_pid = map(int, sys.argv[1:])
    _die_with(parent_pid)
    connection: Connection[Any, Any] = Connection(descriptor)
    sys.path[:] = connection.recv()
    job = connection.recv()
    try:
        detector = job.make_detector()
    except DetectorError as error:
        connection.send(error)
    else:
        _serve(connection, job, detector)


def _serve(connection: Connection[Any, Any], job: Job, detector: Detector) -> None:
    """Send a Ready, then answer each (path, run) with a ProcessResult, a Failure or an error of the store."""
    from inspect_pipeline.pipeline import process  # noqa: PLC0415 - the parent does without OpenCV

    connection.send(Ready(detector.describe()))
    store = Store(job.store_root)
    while True:
        try:
            path, run = connection.recv()
        except (EOFError, OSError):  # the parent has died
            return
        try:
            connection.send(process(path, store, detector, job.options, run))
        except StoreError as error:
            connection.send(error)
        except RecordingError as error:
            connection.send(Failure("unreadable", str(error)))
        except Exception:  # whatever it is, it must not take the other recordings along
            connection.send(Failure("error", traceback.format_exc(limit=-_TRACEBACK_FRAMES)))


def _die_with(parent_pid: int) -> None:
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent_pid:  # it died before it could be told
        os._exit(1)
