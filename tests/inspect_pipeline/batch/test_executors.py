"""What every executor promises: one contract, and each of them held to it with a stub detector."""

from __future__ import annotations

import os
import re
import secrets
import shutil
import signal
import subprocess
import sys
import time
from contextlib import ExitStack, contextmanager
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import pytest
from driver import fork_worker
from factories import Shot, make_recording
from stubs import HANG, KILL, KILL_ONCE, LIGHT, RAISE, MakeStub

from inspect_pipeline.batch import executor as executor_base
from inspect_pipeline.batch import local as executor_local
from inspect_pipeline.batch.executor import Executor, Worker
from inspect_pipeline.batch.inbox import Candidate
from inspect_pipeline.batch.local import LocalExecutor
from inspect_pipeline.batch.ray import RayExecutor
from inspect_pipeline.batch.worker import Job, LoadDetector, Service, WorkerFailure, threads_of
from inspect_pipeline.config import PlacingOptions, ProcessOptions, start_described_run
from inspect_pipeline.errors import DetectorError, StoreError, TerrainError
from inspect_pipeline.store.records import ProcessResult
from inspect_pipeline.store.store import Store

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from inspect_pipeline.batch.executor import Outcome
    from inspect_pipeline.store.records import RunRecord

    Begin = Callable[..., Any]

POPEN = subprocess.Popen
pytestmark = pytest.mark.timeout(900)  # a cluster of Ray takes a minute to start on a busy machine


@contextmanager
def ray_head(folder: Path) -> Iterator[str]:
    """The address of a cluster of one node that lives in this block, with all its processes."""
    folder.mkdir()
    ray = [sys.executable, "-c", "from ray.scripts.scripts import main; main()"]
    options = ["--port=0", "--num-cpus=2", "--include-dashboard=false", f"--object-store-memory={80 * 2**20}"]
    environment = {**os.environ, "RAY_TMPDIR": str(folder), "RAY_USAGE_STATS_ENABLED": "0"}
    head = subprocess.Popen(
        [*ray, "start", "--head", "--block", *options],
        env=environment,
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    try:
        assert head.stdout
        said = ""
        while not (address := re.search("--address='(.+)'", said)):
            line = head.stdout.readline()
            assert line, f"no cluster: {said}"
            said += line
        yield address[1]
    finally:
        head.terminate()
        head.stdout.close()
        head.wait(60)
        assert eventually(lambda: not ray_processes(folder))
        shutil.rmtree(folder)


def ray_processes(folder: Path) -> list[str]:
    """What runs for a cluster of this folder."""
    found = []
    for path in Path("/proc").glob("[0-9]*"):
        try:
            if f"RAY_TMPDIR={folder}".encode() in (path / "environ").read_bytes().split(b"\0"):
                found.append((path / "cmdline").read_text().replace("\0", " "))
        except OSError:  # it has ended
            continue
    return found


def eventually(condition: Callable[[], bool], timeout_s: float = 30.0) -> bool:
    deadline = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.05)
    return True


@pytest.fixture(scope="module")
def cluster() -> Iterator[None]:
    """A cluster that RAY_ADDRESS names, whose actors find the stubs."""
    if find_spec("ray") is None:
        pytest.skip("Ray is not installed: pip install 'lsnet-pipe[ray]'")
    folder = Path(f"/tmp/lsnet-pipe-{secrets.token_hex(4)}")  # noqa: S108 - names of sockets are short
    with pytest.MonkeyPatch.context() as patch, ExitStack() as stack:
        patch.setenv("PYTHONPATH", os.pathsep.join(map(str, [LIGHT, LIGHT.parent])))
        patch.setenv("RAY_AUTH_MODE", "token")
        patch.setenv("RAY_AUTH_TOKEN", secrets.token_hex(32))
        for starts_left in (2, 1, 0):
            try:
                address = stack.enter_context(ray_head(folder))
                break
            except AssertionError:  # it gives its processes 30 s, which is little on a busy machine
                if not starts_left:
                    raise
        patch.setenv("RAY_ADDRESS", address)
        yield


class Site:
    """A store, recordings, and executors over them."""

    def __init__(self, folder: Path, kind: type[Executor[Any]]) -> None:
        self.folder, self.kind = folder, kind
        self.store = Store(folder / "store")
        self.run = start_described_run({}, ProcessOptions(), "batch", {})

    def recording(self, name: str, *numbers: int) -> Candidate:
        path = self.folder / f"{name}.mcap"
        candidate = Candidate.at(make_recording(path, [Shot(n, log_time_ns=10**18 + n) for n in numbers]))
        assert candidate
        return candidate

    def start(self, weights: str = "fast", **options: Any) -> Executor[Any]:
        job = Job(self.store.root, ProcessOptions(), MakeStub(self.folder, weights))
        return self.kind(job, **{"n_workers": 1, "timeout_s": 300.0, "max_attempts": 1} | options)

    def workers(self) -> list[int]:
        """The processes of all detectors there ever were, the youngest last."""
        return [int(pid) for pid in (self.folder / "workers").read_text().split()]

    def is_quiet(self) -> bool:
        """Whether no worker lives, and nothing is left of what they were at."""
        if any(Path(f"/proc/{pid}").exists() for pid in self.workers()):
            return False
        self.store.remove_leftovers()
        staging = self.store.root / "staging"
        return not staging.exists() or [path.name for path in staging.iterdir()] == ["mutex"]


@pytest.fixture(params=["local", pytest.param("ray", marks=pytest.mark.slow)])
def site(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Site]:
    monkeypatch.syspath_prepend(LIGHT)  # which worker processes take over
    if request.param == "ray":
        request.getfixturevalue("cluster")
    else:  # an interpreter takes longer to start than to do its work here
        monkeypatch.setattr(executor_local.subprocess, "Popen", fork_worker)
    site = Site(tmp_path, RayExecutor if request.param == "ray" else LocalExecutor)
    yield site
    if request.param == "local":
        assert not (tmp_path / "workers").exists() or site.is_quiet()
    else:  # the processes of a cluster end when Ray notifies them
        assert not (tmp_path / "workers").exists() or eventually(site.is_quiet)


def results_of(outcomes: Iterator[Outcome]) -> dict[str, tuple[int, str]]:
    """Of each recording the attempts, and the status or the reason of its failure."""
    return {
        outcome.candidate.path.stem: (
            outcome.attempts,
            outcome.result.status if isinstance(outcome.result, ProcessResult) else outcome.result.reason,
        )
        for outcome in outcomes
    }


def test_good_bad_and_poisonous_recordings(site: Site) -> None:
    recordings = [
        site.recording(name, *numbers)
        for name, *numbers in [("poison", 1, KILL), ("once", KILL_ONCE), ("raise", RAISE), ("good", 1, 2)]
    ]
    (site.folder / "none.mcap").write_bytes(b"no recording" * 9)
    recordings.insert(1, Candidate.at(site.folder / "none.mcap"))
    with site.start(max_attempts=2) as executor:
        assert executor.describe()["weights"] == "fast"
        outcomes = results_of(executor.run(recordings, site.run))
    assert outcomes == {
        "poison": (2, "killed"),
        "none": (1, "unreadable"),
        "once": (1, "ok"),  # poison has left the mark that it looks for
        "raise": (2, "error"),
        "good": (1, "ok"),
    }
    flights, halves = site.store.scan()
    assert ({flight.record.totals.n_frames for flight in flights}, halves) == ({1, 2}, [])


def test_a_killed_worker_costs_one_attempt_of_one_recording(
    site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With interpreters of their own, as users have them."""
    monkeypatch.setattr(executor_local.subprocess, "Popen", POPEN)
    recordings = [site.recording("once", KILL_ONCE), site.recording("good", 1)]
    with site.start(n_workers=2, max_attempts=2) as executor:
        outcomes = results_of(executor.run(recordings, site.run))
    assert outcomes == {"once": (2, "ok"), "good": (1, "ok")}


def test_late_recordings_and_workers_that_die_while_they_wait(site: Site) -> None:
    with site.start(timeout_s=1.0) as executor:
        (late,) = executor.run([site.recording("late", HANG)], site.run)
        assert late.result == WorkerFailure("timeout", "not done after 1 s")
        assert late.seconds >= 1
    with site.start() as executor:
        executor.describe()
        idle = site.workers()[-1]
        os.kill(idle, signal.SIGKILL)
        assert eventually(lambda: not _runs(idle))
        assert results_of(executor.run([site.recording("good", 1)], site.run)) == {"good": (1, "ok")}
    assert len(set(site.workers())) == 3


def _runs(pid: int) -> bool:
    """Whether a thread of a process lives; what its parent has yet to look after does not."""
    try:
        threads = [path.read_text() for path in Path(f"/proc/{pid}/task").glob("*/stat")]
    except (FileNotFoundError, ProcessLookupError):
        return True  # it is ending
    return any(thread.rsplit(")", 1)[1].split()[0] != "Z" for thread in threads)


def test_a_stop_drops_what_is_under_way(site: Site) -> None:
    stopped = []
    recordings = [site.recording("a", 1), site.recording("late", HANG), site.recording("b", 2)]
    with site.start(should_stop=lambda: bool(stopped)) as executor:
        for outcome in executor.run(recordings, site.run):
            assert outcome.candidate.path.stem == "a"
            stopped.append(outcome)
        assert executor.describe()
    assert len(stopped) == 1
    with site.start(should_stop=lambda: True) as executor:
        assert (executor.describe(), list(executor.run(recordings, site.run))) == ({}, [])


def test_what_no_worker_can_help_ends_the_run(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(executor_base, "_MAX_FAILED_STARTS", 1)
    recording = site.recording("a", 1)
    with (
        site.start("none") as executor,
        pytest.raises(DetectorError, match="no weights named 'none'"),
    ):
        executor.describe()
    with (
        site.start("deadly") as executor,
        pytest.raises(DetectorError, match=r"^no worker can start \(the worker .*\); run lsnet-pipe doctor"),
    ):
        list(executor.run([recording], site.run))
    (site.folder / "store").mkdir()
    (site.folder / "store" / "flights").touch()
    with site.start() as executor, pytest.raises(StoreError, match="a file is where a folder should be"):
        list(executor.run([recording], site.run))


class Here(Worker):
    """A worker without a process."""

    def __init__(self, job: Job) -> None:
        super().__init__()
        self._service = Service(job)
        self._message: object = self._service.ready()

    def _send(self, path: Path, run: RunRecord) -> bool:
        self._message = self._service.process(path, run)
        return True

    def receive(self) -> object:
        return self._message

    def kill(self) -> None:
        pass


class HereExecutor(Executor[Here]):
    def _start_worker(self) -> Here:
        return Here(self._job)

    def _with_message(self) -> list[Here]:
        return self._workers


def test_a_terrain_model_that_is_gone_is_no_fault_of_a_recording(tmp_path: Path) -> None:
    site = Site(tmp_path, HereExecutor)
    options = ProcessOptions(placing=PlacingOptions(terrain=tmp_path / "gone.tif"))
    job = Job(site.store.root, options, MakeStub(tmp_path))
    with (
        HereExecutor(job, n_workers=1, timeout_s=60.0, max_attempts=3) as executor,
        pytest.raises(TerrainError, match=r"gone\.tif: cannot be read as a terrain model"),
    ):
        list(executor.run([site.recording("a", 1)], site.run))


def test_workers_that_die_at_once_are_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Dead(subprocess.Popen[bytes]):
        def __init__(self, command: list[str], **options: Any) -> None:
            super().__init__(["/bin/false"], **options)
            self.wait()

    monkeypatch.setattr(executor_local.subprocess, "Popen", Dead)
    with (
        Site(tmp_path, LocalExecutor).start() as executor,
        pytest.raises(
            DetectorError, match=r"^no worker can start \(the worker ended with exit code 1\); run"
        ),
    ):
        executor.describe()


def test_workers_that_cannot_be_started_are_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", str(tmp_path / "gone"))
    with (
        Site(tmp_path, LocalExecutor).start() as executor,
        pytest.raises(DetectorError, match=r"^no worker can start \(No such file or directory\); run"),
    ):
        executor.describe()


def test_workers_that_never_get_ready_are_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(executor_local, "START_S", 0.0)
    monkeypatch.setattr(executor_local, "POLL_S", 0.0)
    with (
        Site(tmp_path, LocalExecutor).start() as executor,
        pytest.raises(DetectorError, match=r"^no worker can start \(not ready in time\); run"),
    ):
        executor.describe()


@pytest.mark.parametrize("address", ["", "local"])
def test_ray_without_an_address(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, address: str) -> None:
    monkeypatch.setitem(sys.modules, "ray", ModuleType("ray"))
    monkeypatch.setenv("RAY_ADDRESS", address)
    with (
        Site(tmp_path, RayExecutor).start() as executor,
        pytest.raises(DetectorError, match=r"^RAY_ADDRESS names no cluster; set it"),
    ):
        executor.describe()


@pytest.mark.parametrize("address", ["127.0.0.1:9", "[::1]:9"])
def test_a_cluster_that_is_not_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, address: str) -> None:
    ray = ModuleType("ray")
    ray.shutdown = lambda: None
    monkeypatch.setitem(sys.modules, "ray", ray)
    monkeypatch.setenv("RAY_ADDRESS", address)
    with (
        Site(tmp_path, RayExecutor).start() as executor,
        pytest.raises(
            DetectorError, match=r"^no Ray at .*:9 \(.*refused\); check RAY_ADDRESS, or use local workers$"
        ),
    ):
        executor.describe()


def test_workers_share_the_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _pid: set(range(8)))
    assert [threads_of(n_workers) for n_workers in (1, 2, 3, 8, 20)] == [8, 4, 2, 1, 1]
    asked = []
    monkeypatch.setattr("lsnet.Detector.load", lambda *_, **options: asked.append(options["threads"]))
    LoadDetector("fast", threads=4)()
    assert asked == [4]
