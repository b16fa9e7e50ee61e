"""Frames per second of a detector, from uint8 pixels to segments and lines."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import cv2
import numpy as np
import torch

from lsnet.detector import Detector
from lsnet.errors import LSNetError
from lsnet.evaluation.datasets import images_of
from lsnet.images import load_rgb
from lsnet.model import LSNet
from lsnet.network_config import PRESETS
from lsnet.synth.backgrounds import BackgroundPool
from lsnet.synth.dataset import SyntheticScenes
from lsnet.weights import save_weights
from lsnet.weights_file import WeightsCard

if TYPE_CHECKING:
    from lsnet.arrays import ImageArray
    from lsnet.runtime.backend import Backend

COUNT = 16  # different images, more than the caches of a CPU hold
BATCH = 8


@dataclass(frozen=True, slots=True)
class Speed:
    """The fields of `model bench --json`."""

    frames_per_s: float
    backend: str
    precision: str
    threads: int
    preset: str
    size: int

    def __str__(self) -> str:
        return (
            f"{self.frames_per_s:.1f} frames/s at {self.size}x{self.size}: "
            f"preset {self.preset}, {self.backend} {self.precision}, {self.threads} threads"
        )


def open_untrained(preset: str, runtime: str) -> Detector:
    """Return a detector of a preset with random weights, which takes as long as a trained one.

    Raises:
        LSNetError: The preset or the runtime is unknown or cannot be used.
    """
    if preset not in PRESETS:
        raise LSNetError(f"no preset {preset!r}; choose one of {', '.join(PRESETS)}")
    torch.manual_seed(0)
    card = WeightsCard("untrained", preset, PRESETS[preset], min_score=0.5)
    with TemporaryDirectory() as folder:
        weights = Path(folder) / f"{preset}.safetensors"
        save_weights(weights, LSNet(PRESETS[preset]), card)
        return Detector.load(weights, runtime=runtime, scale=1.0)


def measure_speed(detector: Detector, size: int, folder: Path | None, seconds: float) -> Speed:
    """Measure the frames per second over `seconds`, after a warm-up. Raises LSNetError."""
    images = _squares(folder, size)
    detector.detect(images[:BATCH])
    done, started = 0, time.perf_counter()
    while (elapsed := time.perf_counter() - started) < seconds:
        first = done % COUNT
        detector.detect(images[first : first + BATCH])
        done += BATCH
    used = detector.describe()
    return Speed(
        frames_per_s=round(done / elapsed, 2),
        backend=str(used["backend"]),
        precision=str(used["precision"]),
        threads=detector.threads,
        preset=str(used["preset"]),
        size=size,
    )


def least_cpu_ms(backend: Backend, size: int = 512, repeats: int = 40) -> float:
    """Return the least CPU time of one image in `repeats` runs, ms, which other load hardly changes."""
    image = [SyntheticScenes(BackgroundPool([]), size)[0].image]
    list(backend.run(image))
    times = []
    for _ in range(repeats):
        started = time.process_time_ns()
        list(backend.run(image))
        times.append(time.process_time_ns() - started)
    return min(times) / 1e6


def _squares(folder: Path | None, size: int) -> list[ImageArray]:
    """COUNT square images: centre crops of photographs, enlarged if too small, or synthetic scenes."""
    if folder is None:
        scenes = SyntheticScenes(BackgroundPool([]), size)
        return [scenes[i].image for i in range(COUNT)]
    files = images_of(folder)[1]
    return [_square(load_rgb(files[i % len(files)]), size) for i in range(COUNT)]


def _square(photo: ImageArray, size: int) -> ImageArray:
    factor = max(1.0, size / min(photo.shape[:2]))
    if factor > 1:
        photo = np.asarray(cv2.resize(photo, None, fx=factor, fy=factor), np.uint8)
    y, x = (photo.shape[0] - size) // 2, (photo.shape[1] - size) // 2
    return np.ascontiguousarray(photo[y : y + size, x : x + size])
