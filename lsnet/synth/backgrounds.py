"""Backgrounds: photographs without lines, views of environment maps, drawn grounds."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import cv2
import numpy as np

from lsnet.errors import LSNetError
from lsnet.images import IMAGE_SUFFIXES, load_rgb

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lsnet.arrays import FloatImage, ImageArray, Rng

Part = Literal["all", "training", "held out"]


PLAIN_SHARE = 0.22  # share of drawn plain grounds: asphalt, concrete and sky are rare among photographs
HELD_OUT_SHARE = 0.1  # of a folder: the last files by name, since neighbours are often of one flight
VEGETATION_SHARE = 0.2  # share of drawn vegetation, from near enough to see single leaves


@dataclass(frozen=True, slots=True)
class BackgroundFolder:
    """A folder of images without lines, or its first ones by file name; written DIR or DIR:FIRST."""

    path: Path
    first: int | None = None
    part: Part = "all"  # training and held-out files differ

    @classmethod
    def parse(cls, text: str, part: Part = "all") -> BackgroundFolder:
        """Parse DIR or DIR:FIRST."""
        head, _, tail = text.rpartition(":")
        has_count = bool(head) and tail.isdecimal()
        return cls(Path(head), int(tail), part) if has_count else cls(Path(text), part=part)

    def __str__(self) -> str:
        return f"{self.path.name}, first {self.first}" if self.first else self.path.name

    def files(self) -> list[Path]:
        """Return the image files, sorted by name. Raises LSNetError when there are none."""
        if not self.path.is_dir():
            raise LSNetError(f"{self.path}: not a folder; give a folder of photographs without lines")
        files = sorted(f for f in self.path.iterdir() if f.suffix.lower() in IMAGE_SUFFIXES)[: self.first]
        if not files:
            raise LSNetError(
                f"{self.path}: no images in this folder; give a folder of photographs without lines"
            )
        return part_of(files, self.part)


def part_of(files: list[Path], part: Part) -> list[Path]:
    """Return the files for training or those held out; a single file is in both parts."""
    held_out = max(1, round(HELD_OUT_SHARE * len(files)))
    if part == "training":
        return files[:-held_out] or files
    return files[-held_out:] if part == "held out" else files


class BackgroundPool:
    """Photographs in memory, cropped at random place and scale.

    A folder is used in proportion to the square root of its number of pixels: large photographs more often
    than thumbnails, without dominating. With `drawn`, a share of the grounds is drawn instead; all are, if
    there are no folders.
    """

    def __init__(self, folders: Sequence[BackgroundFolder], *, drawn: bool = True) -> None:
        self._drawn = drawn or not folders
        self._folders = [[load_rgb(f) for f in folder.files()] for folder in folders]
        weights = np.sqrt([sum(photo.size for photo in photos) for photos in self._folders])
        self._shares = weights / weights.sum()

    def sample(self, rng: Rng, size: int) -> FloatImage:
        """Return a random float32 (size, size, 3) background."""
        kind = rng.random() if self._drawn else 1.0
        if kind < VEGETATION_SHARE:
            return vegetation(rng, size)
        if not self._folders or kind < VEGETATION_SHARE + PLAIN_SHARE:
            return plain(rng, size)
        photos = self._folders[rng.choice(len(self._folders), p=self._shares)]
        return cut_out(photos[rng.integers(len(photos))], rng, size)

    def photograph(self, rng: Rng, size: int) -> ImageArray:
        """Return a square of a photograph near its own resolution, or a drawn ground if there is none."""
        if not self._folders:
            return plain(rng, size).clip(0, 255).astype(np.uint8)
        photos = self._folders[rng.choice(len(self._folders), p=self._shares)]
        photo = photos[rng.integers(len(photos))]
        scale = float(np.exp(rng.uniform(np.log(0.45), np.log(1.4))))
        side = min(int(size / scale), *photo.shape[:2])
        y, x = rng.integers(photo.shape[0] - side + 1), rng.integers(photo.shape[1] - side + 1)
        square = np.rot90(photo[y : y + side, x : x + side], int(rng.integers(4)))
        size = min(size, int(side * 1.5))
        how = cv2.INTER_AREA if side > size else cv2.INTER_CUBIC
        return np.asarray(cv2.resize(np.ascontiguousarray(square), (size, size), interpolation=how), np.uint8)


def cut_out(photo: ImageArray, rng: Rng, size: int) -> FloatImage:
    """Crop a random square of a photograph at a random scale, with random quarter turns and mirroring."""
    short = min(photo.shape[:2])
    low, high = min(0.5 * short, 90), min(short, 3.0 * size)
    side = max(1, int(np.exp(rng.uniform(np.log(low), np.log(high)))))
    y, x = rng.integers(photo.shape[0] - side + 1), rng.integers(photo.shape[1] - side + 1)
    square = np.rot90(photo[y : y + side, x : x + side], int(rng.integers(4)))
    if rng.random() < 0.5:
        square = square[:, ::-1]
    how = cv2.INTER_AREA if side > size else cv2.INTER_CUBIC
    image: FloatImage = cv2.resize(np.ascontiguousarray(square), (size, size), interpolation=how).astype(
        np.float32
    )
    if side < size / 1.5:  # enlarged pictures are too smooth: add grain
        image += grain(rng, size, rng.uniform(2, 16), int(rng.integers(1, 4)))
    return image


def grain(rng: Rng, size: int, sigma: float, pitch_px: int) -> FloatImage:
    """Return (size, size, 1) Gaussian noise, smooth over `pitch_px`."""
    count = size // pitch_px + 2
    noise = rng.standard_normal((count, count), dtype=np.float32) * np.float32(sigma)
    smooth = cv2.resize(noise, (size, size), interpolation=cv2.INTER_CUBIC)
    return np.asarray(smooth, np.float32)[..., None]


def plain(rng: Rng, size: int) -> FloatImage:
    """Draw sky, asphalt, concrete or soil: one colour, a gradient, grain and stains."""
    base = np.clip(rng.uniform(15, 240) + rng.normal(0, 18, 3), 0, 255).astype(np.float32)
    angle = rng.uniform(0, 2 * np.pi)
    t = np.linspace(-1, 1, size, dtype=np.float32)
    slope = np.cos(angle) * t + np.sin(angle) * t[:, None]
    image: FloatImage = (
        base + (slope * np.float32(rng.uniform(0, 35)))[..., None] + np.zeros((1, 1, 3), np.float32)
    )
    image += grain(rng, size, rng.uniform(0, 14), 1)
    image += grain(rng, size, rng.uniform(0, 16), int(rng.integers(2, 12)))
    image += grain(rng, size, rng.uniform(0, 22), int(rng.integers(12, 90)))
    return image.astype(np.float32, copy=False)


def vegetation(rng: Rng, size: int) -> FloatImage:
    """Draw leaves, grass, scrub or twigs from near: flat tones with sharp edges, and dark gaps."""
    pitch, stretch = np.exp(rng.uniform(np.log(1.5), np.log(6))), rng.uniform(1, 3.5)
    leaves = _turned_noise(rng, size, pitch, stretch) + 0.6 * _turned_noise(rng, size, 2.3 * pitch, stretch)
    depth = grain(rng, size, rng.uniform(0.1, 0.9), int(rng.integers(15, 90)))[..., 0]
    depth += grain(rng, size, rng.uniform(0.0, 0.8), int(rng.integers(5, 16)))[..., 0]
    t = 0.5 + 0.5 * np.tanh(rng.uniform(0.6, 2.5) * leaves + depth + rng.normal(0, 0.4))
    dark = rng.uniform(3, 60) * (1 + rng.normal(0, 0.12, 3))
    light = rng.uniform(70, 220) * np.array([rng.uniform(0.7, 1.1), 1.0, rng.uniform(0.35, 1.0)])
    middle = (dark + light) * rng.uniform(0.3, 0.6) * (1 + rng.normal(0, 0.1, 3))
    levels = np.stack(
        [np.interp(t, [0, 0.5, 1], tones) for tones in zip(dark, middle, light, strict=True)], -1
    )
    image: FloatImage = levels.astype(np.float32)
    for channel in range(3):  # the hue varies between plants
        image[..., channel : channel + 1] *= 1 + grain(rng, size, 0.08, int(rng.integers(4, 40)))
    return image


def _turned_noise(rng: Rng, size: int, pitch_px: float, stretch: float) -> FloatImage:
    """Return (size, size) noise, smooth over `pitch_px` one way and `stretch` times as far the other way."""
    side = 1.5 * size
    rows, columns = int(side / pitch_px) + 2, int(side / pitch_px / stretch) + 2
    noise = rng.standard_normal((rows, columns), dtype=np.float32)
    angle = rng.uniform(0, np.pi)
    rotate = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    turn = np.diag([1 / (pitch_px * stretch), 1 / pitch_px]) @ rotate
    shift = np.array([columns, rows]) / 2 - turn @ np.array([size, size]) / 2
    how = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    warped = cv2.warpAffine(
        noise, np.column_stack([turn, shift]), (size, size), flags=how, borderMode=cv2.BORDER_REFLECT
    )
    return np.asarray(warped, np.float32)
