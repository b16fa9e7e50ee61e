"""Detectors for tests of worker processes: imported there, counted through a file, deadly where planted."""

from __future__ import annotations

import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from fakes import FakeDetector

from inspect_pipeline.batch.executor import Outcome
from inspect_pipeline.batch.worker import Service
from inspect_pipeline.errors import DetectorError, StoreError, TerrainError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from typing import Any, Self

    from inspect_pipeline.batch.inbox import Candidate
    from inspect_pipeline.batch.worker import Job
    from inspect_pipeline.store.records import RunRecord
    from lsnet import Detections

LIGHT = Path(__file__).with_name("light")  # in front of sys.path, for processes that need no network
KILL, KILL_ONCE, HANG, RAISE = 60, 61, 62, 63  # numbers of pictures, see factories.picture


class StubDetector(FakeDetector):
    """A FakeDetector that notes its process and the images it has seen, and does harm at certain pictures."""

    def __init__(self, folder: Path, weights: str, delay_s: float) -> None:
        super().__init__(weights)
        self._folder, self._delay_s = folder, delay_s
        folder.mkdir(exist_ok=True)
        with (folder / "workers").open("a") as workers:
            workers.write(f"{os.getpid()}\n")

    def detect(self, images: Sequence[Any], **_: object) -> list[Detections]:
        with (self._folder / "seen").open("a") as seen:
            seen.write("x" * len(images))
        time.sleep(self._delay_s)
        for image in images:
            self._harm(int(image[0, 0, 0]) // 4)  # see factories.picture
        return super().detect(images)

    def _harm(self, number: int) -> None:
        if number == KILL or (number == KILL_ONCE and not (self._folder / "killed").exists()):
            (self._folder / "killed").touch()
            os.kill(os.getpid(), signal.SIGKILL)
        if number == HANG:
            time.sleep(600)
        if number == RAISE:
            raise RuntimeError("planted")


@dataclass(frozen=True)
class MakeStub:
    """The factory of a StubDetector; `folder` takes its notes."""

    folder: Path
    weights: str = "fast"
    delay_s: float = 0.0

    def __call__(self) -> StubDetector:
        if self.weights == "none":
            raise DetectorError("no weights named 'none'")
        if self.weights == "deadly":
            os._exit(7)
        return StubDetector(self.folder, self.weights, self.delay_s)

    def n_images(self) -> int:
        """How many images all stubs of this folder have seen."""
        seen = self.folder / "seen"
        return seen.stat().st_size if seen.exists() else 0


def make_stub_in_cwd(weights: str, *_: object, **__: object) -> MakeStub:
    """In place of LoadDetector, for tests of the command line."""
    return MakeStub(Path.cwd(), weights)


class InlineExecutor:
    """In place of LocalExecutor, in this process, for tests of what a batch makes of the outcomes."""

    def __init__(self, job: Job, **options: Any) -> None:
        self._job, self._should_stop = job, options["should_stop"]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        pass

    def describe(self) -> dict[str, Any]:
        return self._job.make_detector().describe()

    def run(self, candidates: Iterable[Candidate], run: RunRecord) -> Iterator[Outcome]:
        for candidate in candidates:
            if self._should_stop():
                return
            yield Outcome(candidate, 1, 0.1, self._attempt(candidate.path, run))

    def _attempt(self, path: Path, run: RunRecord) -> Any:
        result = Service(self._job).process(path, run)
        if isinstance(result, (StoreError, TerrainError)):
            raise result
        return result
