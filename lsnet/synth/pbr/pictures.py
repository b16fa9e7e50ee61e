"""A folder of rendered pictures: PNG with alpha, and the centrelines of each as JSON.

Picture i of a seed is always the same scene, and is written once: an interrupted run continues.
"""

from __future__ import annotations

import json
from functools import partial
from multiprocessing import get_context
from typing import TYPE_CHECKING

import numpy as np

from lsnet.errors import LSNetError
from lsnet.files import make_folder, write_png
from lsnet.synth.pbr.render import lay_out, load_mitsuba, render

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path


def render_many(
    folder: Path,
    count: int,
    *,
    lights: Path | None,
    size: int,
    seed: int,
    workers: int,
    on_image: Callable[[], None] = lambda: None,
) -> None:
    """Write the first `count` pictures of a seed, `size` px wide and high, in `workers` processes.

    Raises:
        LSNetError: Mitsuba is not installed, the folder cannot be written or holds pictures of another size
            or seed, or an environment map cannot be read.
    """
    load_mitsuba()
    maps = sorted(lights.glob("*.hdr")) if lights else []
    if lights and not maps:
        raise LSNetError(f"{lights}: no .hdr files in this folder; give a folder of environment maps")
    make_folder(folder)
    task = partial(_render_one, folder=folder, lights=maps, size=size, seed=seed)
    if workers == 1:
        for index in range(count):
            task(index)
            on_image()
        return
    with get_context("spawn").Pool(workers) as pool:
        for _ in pool.imap_unordered(task, range(count)):
            on_image()


def _render_one(index: int, folder: Path, lights: Sequence[Path], size: int, seed: int) -> None:
    """Write picture `index` and, last, its truth; do nothing if the truth exists."""
    truth = folder / f"{index:06d}.json"
    if truth.exists():
        _check_same(truth, {"size": [size, size], "seed": seed})
        return
    rng = np.random.default_rng([seed, index])
    layout = lay_out(rng, size)
    light = lights[int(rng.integers(len(lights)))] if lights else None
    write_png(truth.with_suffix(".png"), render(layout, light, rng))
    lines = [np.round(line, 2).tolist() for line in layout.lines()]
    partial_file = truth.with_suffix(".partial")
    partial_file.write_text(json.dumps({"size": [size, size], "seed": seed, "lines": lines}) + "\n")
    partial_file.replace(truth)


def _check_same(truth: Path, expected: dict[str, object]) -> None:
    try:
        content = json.loads(truth.read_text())
        is_same = all(content[key] == value for key, value in expected.items())
    except (OSError, ValueError, LookupError, TypeError, RecursionError) as err:
        raise LSNetError(
            f"{truth}: not the truth of a rendered picture ({err}); remove it and its PNG"
        ) from err
    if not is_same:
        raise LSNetError(f"{truth}: of another size or seed; give another folder")
