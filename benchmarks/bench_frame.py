"""What a frame of fifty lines costs besides decoding and the network: merge, track, annotate, index.

    python benchmarks/bench_frame.py [--lines 50] [--frames 200]

A drawn image of 1920 x 1080 with nearly parallel wires, each a quarter of its width long, is processed again
and again, by a network that reports the wires with a little noise. CPU times are those of `lsnet-pipe process
--profile`, of two recordings: a frame costs the difference over their difference in frames, and the rest is
spent once a recording. Checks: all lines are found, and followed as one track each. The last line is one JSON
object.
"""

from __future__ import annotations

import argparse
import base64
import json
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
from bench_speed import print_machine
from mcap.writer import Writer

from inspect_pipeline import process, publish, query
from inspect_pipeline.detection import StageTimes
from lsnet import Detector
from lsnet.grid import POSITIVE, GridCoder
from lsnet.weights_file import read_weights

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lsnet.arrays import Floats, ImageArray, Maps

STAGES = ("merge", "track", "annotate", "index")
HEIGHT, WIDTH, PADDED_HEIGHT = 1080, 1920, 1088
NOISE = 0.3 / 32  # of the ends of segments, in cells


class KnownLines:
    """Stands in for the network, and reports known lines."""

    name, precision, threads, n_calls, n_images = "known", "f32", 1, 1, 1

    def __init__(self, lines: Sequence[Floats]) -> None:
        self._rng = np.random.default_rng(0)
        targets = GridCoder().encode(lines, (PADDED_HEIGHT, WIDTH))
        self._scores = np.where(targets.labels == POSITIVE, 0.9, 0.05).astype(np.float32)
        self._endpoints = targets.endpoints

    def run(self, images: Sequence[ImageArray]) -> list[Maps]:
        """Return the same maps for any image, with noise."""
        noise = self._rng.normal(0, NOISE, (len(images), *self._endpoints.shape)).astype(np.float32)
        return [(self._scores, self._endpoints + each) for each in noise]


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--lines", type=int, default=50)
    parser.add_argument("--frames", type=int, default=200, help="that the longer recording has more")
    arguments = parser.parse_args()
    lines = wires(arguments.lines)
    detector = Detector(read_weights("fast"), KnownLines(lines), 1.0, 0.5)
    print_machine(f"{arguments.lines} lines in frames of {WIDTH} x {HEIGHT}")
    few, many = 10, 10 + arguments.frames
    failed: list[str] = []
    with tempfile.TemporaryDirectory() as name:
        short, long = (measure(Path(name) / str(n), n, lines, detector, failed) for n in (few, many))
    per_frame = {stage: (long[stage] - short[stage]) / (many - few) for stage in STAGES}
    for costs in (short, per_frame):
        costs["together"] = sum(costs.values())
    once = {stage: short[stage] - few * cpu_ms for stage, cpu_ms in per_frame.items()}
    for stage, cpu_ms in per_frame.items():
        print(f"{stage:10} {cpu_ms:6.2f} ms of CPU a frame, {once[stage]:6.0f} ms once")
    rounded = {stage: round(cpu_ms, 3) for stage, cpu_ms in per_frame.items()}
    print(json.dumps({"benchmark": "frame", "lines": arguments.lines, "cpu_ms": rounded, "failed": failed}))
    return 1 if failed else 0


def wires(count: int) -> list[Floats]:
    """Return wires (2, 2) in four columns, beside each other."""
    left = np.arange(count) % 4 * (WIDTH / 4)
    y = np.linspace(15, HEIGHT - 30, count)
    return [np.array([[x, at], [x + WIDTH / 4, at + 10 * np.sin(at)]]) for x, at in zip(left, y, strict=True)]


def measure(
    folder: Path, n_frames: int, lines: Sequence[Floats], detector: Detector, failed: list[str]
) -> dict[str, float]:
    """Return the CPU milliseconds of each stage."""
    folder.mkdir()
    write_recording(folder / "lines.mcap", draw(lines), n_frames)
    times = StageTimes()
    result = process(folder / "lines.mcap", folder / "store", detector, times=times)
    publish(folder / "store")
    ((n_tracks,),) = query(folder / "store", "SELECT count(*) FROM tracks").fetchall()
    if result.n_lines != len(lines) * n_frames or n_tracks != len(lines):
        failed.append(f"{result.n_lines / n_frames:.1f} lines a frame in {n_tracks} tracks")
    stages = times.stages()
    return {stage: 1e3 * stages[stage][1] for stage in STAGES}


def draw(lines: Sequence[Floats]) -> bytes:
    """Draw wires on blurred noise, as JPEG."""
    noise = np.random.default_rng(0).uniform(90, 160, (HEIGHT, WIDTH, 3))
    image = cv2.GaussianBlur(noise, (0, 0), 4).astype(np.uint8)
    for line in lines:
        start, end = (tuple(np.round(point).astype(int).tolist()) for point in line)
        cv2.line(image, start, end, (20, 20, 20), 2, cv2.LINE_AA)
    return cv2.imencode(".jpg", image)[1].tobytes()


def write_recording(path: Path, image: bytes, n_frames: int) -> None:
    """Write the same image as `foxglove.CompressedImage` at ten frames a second."""
    text = base64.b64encode(image).decode()
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("foxglove.CompressedImage", "jsonschema", b"{}")
        channel = writer.register_channel("/camera", "json", schema)
        for i in range(n_frames):
            at_ns = 1_700_000_000_000_000_000 + i * 100_000_000
            stamp = {"sec": at_ns // 10**9, "nsec": at_ns % 10**9}
            message = {"timestamp": stamp, "frame_id": "camera", "data": text, "format": "jpeg"}
            writer.add_message(channel, at_ns, json.dumps(message).encode(), at_ns)
        writer.finish()


if __name__ == "__main__":
    sys.exit(main())
