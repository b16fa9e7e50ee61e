"""Workers that are actors of Ray, in the cluster of RAY_ADDRESS.

All machines of the cluster find the store, the recordings and weights given by file under the same names. Ray
restarts no actor and repeats no call: attempts are counted in one place, the executor.
"""

from __future__ import annotations

import logging
import os
import platform
import signal
import socket
import time
from contextlib import ExitStack, chdir, contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from inspect_pipeline.batch.executor import POLL_S, START_S, Executor, Worker, signals_blocked
from inspect_pipeline.batch.worker import Service, WorkerFailure
from inspect_pipeline.errors import DetectorError, ExecutorError
from inspect_pipeline.resources import app_version

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from types import TracebackType

    from inspect_pipeline.batch.worker import Job, Ready
    from inspect_pipeline.errors import StoreError, TerrainError
    from inspect_pipeline.store.records import ProcessResult, RunRecord

_PING_S = 10.0
# Read when Ray is imported: no usage statistics, and messages about dead actors are left to the executor.
_QUIET = {
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_DEDUP_LOGS_SKIP_REGEX": ".",
    "RAY_BACKEND_LOG_LEVEL": "fatal",
}


class RayExecutor(Executor["_Actor"]):
    """Up to `n_workers` actors, which ask the cluster for one CPU each."""

    def __init__(self, job: Job, **options: Any) -> None:
        super().__init__(job, **options)
        self._ray: Any = None
        self._connection = ExitStack()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._connection:
            super().__exit__(kind, error, trace)

    def _start_worker(self) -> _Actor:
        if self._ray is None:
            self._ray = self._connection.enter_context(_connected())
        return _Actor(self._ray, self._job)

    def _with_message(self) -> list[_Actor]:
        awaited = {worker.pending: worker for worker in self._workers if worker.pending is not None}
        done, _ = self._ray.wait(list(awaited), timeout=POLL_S)
        return [awaited[reference] for reference in done]


class _Actor(Worker):
    """The batch's handle of an actor; `pending` refers to its next message."""

    def __init__(self, ray: Any, job: Job) -> None:
        super().__init__()
        self._ray = ray
        options = {"num_cpus": 1, "max_restarts": 0, "max_task_retries": 0, "scheduling_strategy": "SPREAD"}
        self._handle = ray.remote(**options)(RecordingActor).remote()
        threads = os.environ.get("OMP_NUM_THREADS")
        self.pending = self._handle.load.remote(job, app_version(), Path.cwd(), threads)
        self.deadline = time.monotonic() + START_S

    def _send(self, path: Path, run: RunRecord) -> bool:
        self.pending = self._handle.ping.remote()
        try:
            self._ray.get(self.pending, timeout=_PING_S)
        except self._ray.exceptions.RayError:
            return False
        self.pending = self._handle.process.remote(path, run)
        return True

    def receive(self) -> Any:
        """Return the result of the actor, or a WorkerFailure when it is lost."""
        reference, self.pending = self.pending, None
        try:
            return self._ray.get(reference)
        except self._ray.exceptions.RayError as error:
            return WorkerFailure("killed", _explain(error))

    def kill(self) -> None:
        """End the process; on another machine that may take longer than this call."""
        self._ray.kill(self._handle)


class RecordingActor:
    """The code of an actor. Ray calls one method at a time."""

    def load(self, job: Job, wanted_version: str, folder: Path, threads: str | None) -> Ready | DetectorError:
        """Load the detector, in the same surroundings as a worker process on the batch's machine.

        folder: where the batch runs, for relative paths; threads: its OMP_NUM_THREADS, which Ray sets to 1.
        """
        if app_version() != wanted_version:
            return DetectorError(
                f"{platform.node()}: lsnet-pipe is {app_version()} there and {wanted_version} here;"
                " install the same on all machines"
            )
        if threads is None:
            os.environ.pop("OMP_NUM_THREADS", None)
        with suppress(OSError):
            os.chdir(folder)
        try:
            self._service = Service(job)
        except DetectorError as error:
            return error
        return self._service.ready()

    def ping(self) -> None:
        """Return, to show that the actor is alive."""

    def process(
        self, path: Path, run: RunRecord
    ) -> ProcessResult | WorkerFailure | StoreError | TerrainError:
        """Process a recording."""
        return self._service.process(path, run)


@contextmanager
def _connected() -> Iterator[Any]:
    """Connect to the cluster of RAY_ADDRESS; raises DetectorError, ExecutorError."""
    with _environment(_QUIET):
        ray = _import_ray()
    address = os.environ.get("RAY_ADDRESS", "")
    if address in ("", "local"):
        raise ExecutorError(
            "RAY_ADDRESS names no cluster; set it to the address of one, as `ray start --head` prints it"
        )
    try:
        _initialize(ray, address)
        yield ray
    finally:
        ray.shutdown()


def _import_ray() -> Any:
    try:
        import ray  # noqa: PLC0415 - takes a second, and few need it
    except ImportError as error:
        raise ExecutorError("Ray is not installed; pip install 'lsnet-pipe[ray]'") from error
    return ray


def _initialize(ray: Any, address: str) -> None:
    """Call ray.init, in an empty folder as Ray puts the current one on the sys.path of actors.

    Raises DetectorError when stopped meanwhile, ExecutorError when there is no such cluster.
    """
    try:
        _check_reachable(address)
        with _environment(_QUIET), _own_signals(), TemporaryDirectory() as folder, chdir(folder):
            ray.init(address=address, log_to_driver=False, logging_level=logging.CRITICAL)
    except SystemExit as error:  # Ray turns a SIGTERM into it, which the batch is to handle
        signal.raise_signal(signal.SIGTERM)
        raise DetectorError(f"no Ray at {address}: stopped before") from error
    except Exception as error:  # Ray raises many kinds, including Exception itself
        raise ExecutorError(
            f"no Ray at {address} ({_explain(error)}); check RAY_ADDRESS, or use local workers"
        ) from error


def _check_reachable(address: str) -> None:
    """Raise OSError when nothing listens at host:port, for which Ray would take minutes."""
    host, _, port = address.rpartition(":")
    if host and port.isdecimal() and "/" not in host:
        socket.create_connection((host.strip("[]"), int(port)), timeout=_PING_S).close()


@contextmanager
def _own_signals() -> Iterator[None]:
    """Shield Ray's processes from the signals that end a batch, and keep the batch's handler of SIGTERM."""
    handler = signal.getsignal(signal.SIGTERM)
    with signals_blocked():
        try:
            yield
        finally:
            signal.signal(signal.SIGTERM, handler)


@contextmanager
def _environment(variables: Mapping[str, str]) -> Iterator[None]:
    """Set environment variables inside the block."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _explain(error: Exception) -> str:
    """Return the last line of a message of Ray, which says little about a process that died."""
    lines = str(error).strip().splitlines() or [type(error).__name__]
    if "connection error code 2. End of file" in lines[-1]:
        return "the worker died; is there enough memory?"
    return lines[-1].partition(" Some common causes")[0].strip()
