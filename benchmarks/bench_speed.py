"""The detector at sizes of cameras, in turn with M-LSD-tiny at 512 px where its file is given.

    python benchmarks/bench_speed.py [--rival M-LSD_512_tiny_fp32.tflite] [--repeats 15] [--runtime auto]

Times are medians of single images over the repeats, after a warm-up: wall, and CPU of all threads, which
other load on the machine changes less. The rival runs in the same rounds on the same pixels. Checks: an image
in a batch has the results it has alone, and the scores of the runtime are those of torch in f32, up to the
rounding of its precision. The last line is one JSON object.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import sys
import time
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from lsnet import Detector
from lsnet.evaluation.baselines.mlsd import MLSD
from lsnet.network_config import PRESETS
from lsnet.preprocess import prepare
from lsnet.synth.backgrounds import BackgroundPool
from lsnet.synth.dataset import SyntheticScenes
from lsnet.tiles import tiles_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

SIZES = {
    "512": (512, 512),
    "720p": (720, 1280),
    "1080p": (1080, 1920),
    "4K": (2160, 3840),
    "50 MP": (5792, 8688),
}
TOLERANCE = {"f32": 1e-3, "bf16": 0.05, "int8": 0.2}  # of the mean score over the cells


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--rival", type=Path, help="the .tflite file of M-LSD-tiny 512")
    parser.add_argument("--repeats", type=int, default=15)
    parser.add_argument("--runtime", default="auto")
    parser.add_argument("--sizes", nargs="*", default=["512", "720p", "1080p", "4K"], choices=SIZES)
    arguments = parser.parse_args()
    detector = Detector.load(runtime=arguments.runtime, scale=1.0)
    used = detector.describe()
    print_machine(f"{used['weights']}, {used['backend']} {used['precision']}, {detector.threads} threads")
    result: dict[str, object] = {"benchmark": "speed", "repeats": arguments.repeats}
    print(f"{'size':>8} {'wall ms':>9} {'CPU ms':>9} {'frames/s':>9} {'pixels run':>11}")
    for name in arguments.sizes:
        image = scene(SIZES[name])
        (wall_ms, cpu_ms), *_ = alternate([lambda im=image: detector.detect([im])], arguments.repeats)
        ratio = pixels_run(image) / (image.shape[0] * image.shape[1])
        print(f"{name:>8} {wall_ms:9.1f} {cpu_ms:9.1f} {1e3 / wall_ms:9.1f} {ratio:11.3f}", flush=True)
        result[name] = {
            "wall_ms": round(wall_ms, 2),
            "cpu_ms": round(cpu_ms, 2),
            "pixels_run": round(ratio, 3),
        }
    if arguments.rival:
        result["times_mlsd_tiny_512"] = against_rival(detector, arguments.rival, arguments.repeats)
    failed = check(detector)
    print(json.dumps(result | {"failed": failed}))
    return 1 if failed else 0


def print_machine(detector: str) -> None:
    """What the figures depend on."""
    cpu = next((x.split(":")[1].strip() for x in open("/proc/cpuinfo") if "model name" in x), "?")  # noqa: SIM115, PTH123
    load = "/".join(f"{value:.1f}" for value in os.getloadavg())
    packages = ", ".join(
        f"{name} {version(name)}" for name in ("openvino", "torch", "opencv-python-headless")
    )
    print(
        f"{cpu}, {len(os.sched_getaffinity(0))} cores, load {load}, Python {platform.python_version()}, "
        + packages
    )
    print(detector)


def scene(size: tuple[int, int]) -> NDArray[np.uint8]:
    """Cables over drawn ground, enlarged."""
    image = SyntheticScenes(BackgroundPool([]), 512)[0].image
    return np.ascontiguousarray(cv2.resize(image, size[::-1], interpolation=cv2.INTER_CUBIC))


def alternate(methods: list[Callable[[], object]], repeats: int) -> list[tuple[float, float]]:
    """Median wall and CPU milliseconds of each method, run in turn after two rounds of warm-up."""
    times: list[list[tuple[float, float]]] = [[] for _ in methods]
    for i in range(repeats + 2):
        for method, done in zip(methods, times, strict=True):
            wall, cpu = time.perf_counter(), time.process_time()
            method()
            if i >= 2:
                done.append((time.perf_counter() - wall, time.process_time() - cpu))
    return [tuple(1e3 * statistics.median(each) for each in zip(*done, strict=True)) for done in times]  # type: ignore[misc]


def pixels_run(image: NDArray[np.uint8]) -> int:
    """Pixels that the network runs on, tiles and padding included."""
    tiles = tiles_of(*prepare(image, 1.0).padded_size, PRESETS["fast"].pixels_at_once)
    return sum((t.window[0].stop - t.window[0].start) * (t.window[1].stop - t.window[1].start) for t in tiles)


def against_rival(detector: Detector, path: Path, repeats: int) -> float:
    """How many times the CPU time of the detector the rival takes, the median of a round."""
    precision = str(detector.describe()["precision"])
    rival, image = MLSD(path, "bf16" if precision == "int8" else precision), scene((512, 512))
    ours, theirs = alternate([lambda: detector.detect([image]), lambda: rival.detect([image])], repeats)
    times = theirs[1] / ours[1]
    print(f"M-LSD-tiny 512: {theirs[0]:.1f} ms wall, {theirs[1]:.1f} ms CPU, {times:.2f} times ours")
    return round(times, 2)


def check(detector: Detector) -> list[str]:
    """What does not agree."""
    images = [scene((512, 512)), scene((720, 1280))]
    failed = []
    for together, image in zip(detector.detect(images), images, strict=True):
        (alone,) = detector.detect([image])
        if not np.array_equal(together.segments.endpoints, alone.segments.endpoints):
            failed.append("an image in a batch differs from the image alone")
    reference = Detector.load(runtime="torch", scale=1.0)
    prepared = [prepare(image, 1.0) for image in images]
    for ours, theirs in zip(detector._run(prepared), reference._run(prepared), strict=True):
        if np.abs(ours[0] - theirs[0]).mean() > TOLERANCE[str(detector.describe()["precision"])]:
            failed.append("the scores differ from those of torch in f32")
    return failed


if __name__ == "__main__":
    sys.exit(main())
