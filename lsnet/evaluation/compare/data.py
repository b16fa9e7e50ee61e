"""A set of synthetic images on disk, so that networks and losses are compared on the same ones."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from torch.utils.data import DataLoader, Dataset

from lsnet.evaluation.baselines.wd_dcnn import LINE_PX, drawn_lines
from lsnet.files import make_folder, write_png
from lsnet.synth.backgrounds import BackgroundFolder, BackgroundPool
from lsnet.synth.dataset import SampleSource, SyntheticScenes
from lsnet.synth.drawing import Sample
from lsnet.synth.paper import PaperScenes

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from lsnet.arrays import Floats, ImageArray


DRAWN_PX = 384
IMAGES_FILE, LINES_FILE = "images.npy", "lines.npz"


class _Drawn(Dataset[Sample]):
    def __init__(self, scenes: SampleSource) -> None:
        self._scenes = scenes

    def __getitem__(self, index: int) -> Sample:
        return self._scenes[index]


def draw_set(
    folder: Path,
    backgrounds: Sequence[str],
    count: int,
    *,
    seed: int,
    workers: int,
    as_paper: bool = False,
    on_image: Callable[[], None] = lambda: None,
) -> None:
    """Fill a folder with `count` synthetic images and their lines, unless it has them already.

    Args:
        folder: Where the set is kept.
        backgrounds: Folders to draw on, as DIR or DIR:FIRST.
        count: Images.
        seed: Of the images.
        workers: Processes that draw.
        as_paper: Leave out clutter, towers and weather, which the paper does not draw.
        on_image: Called after each image.

    Raises:
        LSNetError: A background folder (DIR or DIR:FIRST) has no images, or the set's folder cannot be
            created.
    """
    make_folder(folder)
    if (folder / LINES_FILE).exists():  # written last
        return
    pool = BackgroundPool([BackgroundFolder.parse(text) for text in backgrounds])
    source = (PaperScenes if as_paper else SyntheticScenes)(pool, DRAWN_PX, seed)
    shape = (count, DRAWN_PX, DRAWN_PX, 3)
    images = np.lib.format.open_memmap(folder / IMAGES_FILE, mode="w+", dtype=np.uint8, shape=shape)
    drawn = DataLoader(_Drawn(source), batch_size=None, sampler=range(count), num_workers=workers)
    lines = []
    for i, sample in enumerate(drawn):
        images[i] = sample.image
        lines.append(sample.lines)
        on_image()
    images.flush()
    _save_lines(folder / LINES_FILE, lines)


def _save_lines(path: Path, lines: list[list[Floats]]) -> None:
    """Save the points of all lines in one array, with the image and the number of points of each line."""
    flat = [(i, line) for i, of_image in enumerate(lines) for line in of_image]
    partial = path.with_name(f"partial-{path.name}")
    np.savez(
        partial,
        points=np.concatenate([line for _, line in flat] or [np.zeros((0, 2))]),
        counts=np.array([len(line) for _, line in flat], int),
        image=np.array([i for i, _ in flat], int),
    )
    os.replace(partial, path)  # noqa: PTH105


def write_held_out(folder: Path, first: int) -> Path:
    """Write the images of a set from `first` on as an evaluation set, unless it exists; return its folder.

    They are of the kind that is trained on, so networks differ on them by what they learned, and not by what
    real photographs have besides. The true pixels are the centrelines, `LINE_PX` wide. Images without lines,
    on which a network that finds nothing is right, are left out.

    Raises:
        LSNetError: The folder cannot be written.
    """
    held_out = folder / "held_out"
    for name in ("images", "masks"):
        make_folder(held_out / name)
    crops = Crops.of(folder, first, 0, size=0, seed=0)
    for which in range(first, len(crops.images)):
        truth = held_out / "masks" / f"{which:06d}.png"
        mask = drawn_lines(crops.lines[which], crops.images.shape[1:3], LINE_PX)
        if truth.exists() or not mask.any():
            continue
        write_png(held_out / "images" / truth.name, crops.images[which])
        write_png(truth, np.repeat(mask[..., None], 3, axis=2).astype(np.uint8) * 255)
    return held_out


@dataclass(frozen=True, slots=True, eq=False)
class Crops:
    """Random square crops, some mirrored, of images `first` to `last` of a set."""

    images: ImageArray
    lines: list[list[Floats]]
    first: int
    last: int
    size: int
    seed: int

    @classmethod
    def of(cls, folder: Path, first: int, last: int, *, size: int, seed: int) -> Crops:
        """Open the crops of a folder filled by `draw_set`."""
        images = np.load(folder / IMAGES_FILE, mmap_mode="r")
        with np.load(folder / LINES_FILE) as kept:
            points = np.split(kept["points"], np.cumsum(kept["counts"])[:-1])
            owners = kept["image"]
        lines: list[list[Floats]] = [[] for _ in images]
        for owner, line in zip(owners, points, strict=False):  # one empty piece where there are no lines
            lines[owner].append(line)
        return cls(images, lines, first, last, size, seed)

    def __getitem__(self, index: int) -> Sample:
        rng = np.random.default_rng([self.seed, index])
        which = int(rng.integers(self.first, self.last))
        spare = np.array(self.images.shape[1:3]) - self.size
        y, x = rng.integers(0, spare + 1)
        image = self.images[which, y : y + self.size, x : x + self.size]
        lines = [line - (x, y) for line in self.lines[which]]
        for axis in (0, 1):
            if rng.random() < 0.5:
                image = np.flip(image, 1 - axis)
                for line in lines:
                    line[:, axis] = self.size - line[:, axis]
        return Sample(np.ascontiguousarray(image), lines)
