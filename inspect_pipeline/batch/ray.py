"""Workers that are actors of Ray, in the cluster of RAY_ADDRESS or in one of this machine for the time being.

All machines of the cluster find the store, the recordings and weights given by file under the same names. Ray
restarts no actor and repeats no call: attempts are counted in one place, the executor.
"""

from __future__ import annotations

import logging
import os
import platform
import secrets
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
    from collections.abc import Callable, Iterator, Mapping
    from types import TracebackType

    from inspect_pipeline.batch.worker import Job, Ready
    from inspect_pipeline.errors import StoreError, TerrainError
    from inspect_pipeline.store.records import ProcessResult, RunRecord

_PING_S = 10.0
_END_S = 10.0
_MAX_STARTS = 3  # of a cluster of this machine; Ray waits 30 s for its own processes, a busy machine longer
_OBJECT_STORE_BYTES = 80 * 2**20  # near the least there can be: only paths and results pass through it
_FOLDER = "RAY_TMPDIR"  # in the environment of all processes of a cluster of this machine
_TOKEN = secrets.token_hex(32)
# Read when Ray is imported: it sends no statistics, and leaves it to us to say that an actor has died.
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
            self._ray = self._connection.enter_context(_connected(self._n_workers, self._should_stop))
        return _Actor(self._ray, self._job)

    def _with_message(self) -> list[_Actor]:
        awaited = {worker.pending: worker for worker in self._workers if worker.pending is not None}
        done, _ = self._ray.wait(list(awaited), timeout=POLL_S)
        return [awaited[reference] for reference in done]


class _Actor(Worker):
    """An actor, as the batch sees it; `pending` stands for its next message."""

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
        """What the actor has returned, or a WorkerFailure when there is no such thing any more."""
        reference, self.pending = self.pending, None
        try:
            return self._ray.get(reference)
        except self._ray.exceptions.RayError as error:
            return WorkerFailure("killed", _explain(error))

    def kill(self) -> None:
        """Have the process end; on another machine that may take a moment longer than this call."""
        self._ray.kill(self._handle)


class RecordingActor:
    """What runs in the process of an actor. Ray calls one method at a time."""

    def load(self, job: Job, wanted_version: str, folder: Path, threads: str | None) -> Ready | DetectorError:
        """Get ready as a worker process of the batch's machine would.

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
        """Return, which a dead actor cannot."""

    def process(
        self, path: Path, run: RunRecord
    ) -> ProcessResult | WorkerFailure | StoreError | TerrainError:
        """What became of a recording."""
        return self._service.process(path, run)


@contextmanager
def _connected(n_cpus: int, should_stop: Callable[[], bool]) -> Iterator[Any]:
    """Ray, connected to the cluster of RAY_ADDRESS or to one of this block; raises DetectorError."""
    address = os.environ.get("RAY_ADDRESS") or "local"
    with TemporaryDirectory(prefix="lsnet-pipe-", ignore_cleanup_errors=True) as folder:
        options: dict[str, Any] = {"address": address}
        environment = dict(_QUIET)
        if address == "local":
            options |= {
                "num_cpus": n_cpus,
                "include_dashboard": False,
                "object_store_memory": _OBJECT_STORE_BYTES,
            }
            environment |= {_FOLDER: folder, "RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": _TOKEN}
        with _environment(environment):
            ray = _import_ray()
        try:
            with _environment(environment):
                _initialise(ray, options, folder, should_stop)
            yield ray
        finally:
            ray.shutdown()
            _end_processes(folder)


def _import_ray() -> Any:
    try:
        import ray  # noqa: PLC0415 - takes a second, and few need it
    except ImportError as error:
        raise ExecutorError("Ray is not installed; pip install 'lsnet-pipe[ray]'") from error
    return ray


def _initialise(ray: Any, options: Mapping[str, Any], folder: str, should_stop: Callable[[], bool]) -> None:
    """ray.init, without the current folder on the sys.path of actors; raises DetectorError."""
    address = options["address"]
    for n_starts_left in reversed(range(_MAX_STARTS if address == "local" else 1)):
        try:
            _check_reachable(address)
            with _own_signals(), chdir(folder):
                ray.init(**options, log_to_driver=False, logging_level=logging.CRITICAL)
        except SystemExit as error:  # made by Ray of a SIGTERM, which is for the batch to handle
            signal.raise_signal(signal.SIGTERM)
            raise DetectorError(f"no Ray at {address}: stopped before") from error
        except Exception as error:  # Ray raises many kinds, also the plain one
            if not n_starts_left or should_stop():
                raise ExecutorError(
                    f"no Ray at {address} ({_explain(error)}); check RAY_ADDRESS, or use local workers"
                ) from error
        else:
            return
        _end_processes(folder)


def _check_reachable(address: str) -> None:
    """Raise OSError when nobody is at host:port, which Ray would take minutes to say."""
    host, _, port = address.rpartition(":")
    if host and port.isdecimal() and "/" not in host:
        socket.create_connection((host.strip("[]"), int(port)), timeout=_PING_S).close()


@contextmanager
def _own_signals() -> Iterator[None]:
    """Processes of Ray get none of the signals that end a batch, and the batch keeps its handler of them."""
    handler = signal.getsignal(signal.SIGTERM)
    with signals_blocked():
        try:
            yield
        finally:
            signal.signal(signal.SIGTERM, handler)


@contextmanager
def _environment(variables: Mapping[str, str]) -> Iterator[None]:
    """Environment variables as they are to be inside the block."""
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


def _end_processes(folder: str) -> None:
    """End what is left of a cluster of this machine: some processes are slow to notice its end."""
    mark, deadline = f"{_FOLDER}={folder}".encode(), time.monotonic() + _END_S
    while time.monotonic() < deadline:
        pids = [pid for pid, environment in _environments() if mark in environment]
        if not pids:
            return
        for pid in pids:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        time.sleep(0.05)


def _environments() -> Iterator[tuple[int, list[bytes]]]:
    """What processes of this user were started with; nothing of those that have ended."""
    for path in Path("/proc").glob("[0-9]*/environ"):
        with suppress(OSError):
            yield int(path.parent.name), path.read_bytes().split(b"\0")


def _explain(error: Exception) -> str:
    """The last line of what Ray says; of a process that is gone it knows no more than that."""
    lines = str(error).strip().splitlines() or [type(error).__name__]
    if "connection error code 2. End of file" in lines[-1]:
        return "the worker died; is there enough memory?"
    return lines[-1].partition(" Some common causes")[0].strip()
