"""Where the examples of a line score come from, in one process or several."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import get_context
from typing import TYPE_CHECKING

from lsnet.errors import LSNetError
from lsnet.runtime.backend import open_backend
from lsnet.synth.backgrounds import BackgroundFolder, BackgroundPool
from lsnet.synth.pbr.scenes import rendered_pictures
from lsnet.training.line_scenes import Examples, LineScenes
from lsnet.weights_file import read_weights

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from lsnet.synth.backgrounds import Part

CHUNK = 8  # scenes that a worker takes at once


@dataclass(frozen=True, slots=True)
class LineSource:
    """What is drawn, and the network that proposes lines in it.

    Attributes:
        weights: Name of shipped weights, or a .safetensors file.
        backgrounds: Folders of photographs without lines, DIR or DIR:FIRST.
        rendered: Folder of `model synth`.
        part: Which of the photographs and of the rendered pictures.
        seed: Of the scenes.
    """

    weights: str | Path
    backgrounds: tuple[str, ...]
    rendered: Path | None
    part: Part
    seed: int

    def scenes(self) -> LineScenes:
        """Return the scenes. Raises LSNetError as its folders do."""
        pool = BackgroundPool([BackgroundFolder.parse(text, self.part) for text in self.backgrounds])
        pictures = rendered_pictures(self.rendered, self.part) if self.rendered else ()
        return LineScenes(pool, pictures, self.seed)

    def open(self, threads: int | None = None) -> Callable[[int], Examples | None]:
        """Return the function that gives the proposals in scene i. Raises LSNetError as its folders do."""
        scenes = self.scenes()
        backend = open_backend(read_weights(self.weights), "auto", threads=threads)
        return lambda index: scenes.examples(index, backend)


def collect(source: LineSource, count: int, workers: int, on_scene: Callable[[], None]) -> Examples | None:
    """Return the proposals in the first `count` scenes, in order; None if there are none.

    Raises:
        LSNetError: A folder cannot be used, or a process that draws ended.
    """
    parts = []
    for found in _each(source, count, workers):
        parts += [found] if found else []
        on_scene()
    return Examples.joined(parts) if parts else None


def _each(source: LineSource, count: int, workers: int) -> Iterator[Examples | None]:
    if workers == 1:
        yield from map(source.open(), range(count))
        return
    source.scenes()  # so that a folder that cannot be used is an error of this process
    spawn = get_context("spawn")
    with ProcessPoolExecutor(workers, spawn, initializer=_start_worker, initargs=(source,)) as pool:
        try:
            yield from pool.map(_look, range(count), chunksize=CHUNK)
        except BrokenProcessPool as error:
            raise LSNetError("a process that draws ended; run again, with fewer --workers") from error


_worker: list[Callable[[int], Examples | None]] = []  # of this process


def _start_worker(source: LineSource) -> None:
    _worker[:] = [source.open(threads=1)]


def _look(index: int) -> Examples | None:
    return _worker[0](index)
