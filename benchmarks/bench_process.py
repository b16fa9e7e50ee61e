"""Recordings of JPEG images through `lsnet-pipe process` and `batch`, from start to published index.

    python benchmarks/bench_process.py [--sizes 1920x1080 3840x2160] [--frames 20] [--copies 5] [--jobs 2]

Simulated images are repeated, since drawing them takes longer than detecting in them. In the same rounds the
mcap package rewrites the recording, message by message, without looking at the images. `batch` processes four
recordings by one worker and by several. Wall times depend on what else runs; the CPU time of all processes
hardly does. Checks: every frame has its row, batches find the same number of lines as `process`. The last
line is one JSON object.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from bench_speed import print_machine
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from inspect_pipeline import SimulationOptions, query, simulate
from lsnet import Detector

FPS = 5.0


@dataclass(frozen=True, slots=True)
class Usage:
    """Wall and CPU seconds of a process and its children, and the peak of the largest, bytes."""

    wall_s: float
    cpu_s: float
    peak_bytes: int


def main() -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--sizes", nargs="*", default=["1920x1080", "3840x2160"])
    parser.add_argument("--frames", type=int, default=20, help="that are simulated")
    parser.add_argument("--copies", type=int, default=5, help="of them in a recording")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    print_machine(str(Detector.load().describe()))
    result: dict[str, object] = {"benchmark": "process", "failed": (failed := [])}
    with tempfile.TemporaryDirectory() as name:
        for size in arguments.sizes:
            result[size] = measure(Path(name), size, arguments, failed)
    print(json.dumps(result))
    return 1 if failed else 0


def measure(folder: Path, size: str, arguments: argparse.Namespace, failed: list[str]) -> dict[str, float]:
    """Process and batch recordings of one size, and print a line for each."""
    inbox = folder / f"inbox{size}"
    inbox.mkdir()
    source, n_frames = folder / f"{size}.mcap", arguments.frames * arguments.copies
    width, height = map(int, size.split("x"))
    simulate(source, SimulationOptions(seconds=arguments.frames / FPS, fps=FPS, image_size=(height, width)))
    for i in range(4):
        repeat(source, inbox / f"{i}.mcap", arguments.copies, arguments.frames, shift_ns=i * 10**12)
    rounds: dict[str, list[Usage]] = {"process": [], "mcap rewrite": [], "batch 1": [], "batch N": []}
    for i in range(arguments.rounds):
        store = folder / f"store{size}{i}"
        rounds["process"].append(run("process", inbox / "0.mcap", "--store", store))
        n_lines = count_lines(store, failed, n_frames)
        rounds["mcap rewrite"].append(run_python(__file__, inbox / "0.mcap", folder / "rewritten.mcap"))
        for name, jobs in (("batch 1", 1), ("batch N", arguments.jobs)):
            jobs_store = folder / f"store{size}{i}jobs{jobs}{name[-1]}"
            rounds[name].append(run("batch", inbox, "--store", jobs_store, "--jobs", jobs, "--settle", 0))
            if count_lines(jobs_store, failed, 4 * n_frames) != 4 * n_lines:
                failed.append(f"{size}, {name}: another number of lines than process")
    return table(size, rounds, n_frames)


def table(size: str, rounds: dict[str, list[Usage]], n_frames: int) -> dict[str, float]:
    figures = {}
    print(f"{size:12} {'frames/s':>9} {'CPU ms/frame':>13} {'wall of CPU':>12} {'peak MiB':>9}")
    for name, done in rounds.items():
        frames = n_frames * (4 if name.startswith("batch") else 1)
        per_s = statistics.median(frames / each.wall_s for each in done)
        cpu_ms = statistics.median(1e3 * each.cpu_s / frames for each in done)
        share = statistics.median(each.wall_s * len(os.sched_getaffinity(0)) / each.cpu_s for each in done)
        peak = max(each.peak_bytes for each in done) / 2**20
        print(f"{name:12} {per_s:9.2f} {cpu_ms:13.1f} {share:12.2f} {peak:9.0f}", flush=True)
        figures |= {f"{name} frames_per_s": round(per_s, 2), f"{name} cpu_ms": round(cpu_ms, 2)}
    return figures


def repeat(source: Path, target: Path, copies: int, n_frames: int, *, shift_ns: int) -> None:
    """Write the messages of a recording several times, one after the other."""
    span_ns = round(n_frames / FPS * 1e9)
    with target.open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start()
        ids: dict[int, int] = {}
        for i in range(copies):
            with source.open("rb") as original:
                for schema, channel, message in make_reader(original).iter_messages():
                    if channel.id not in ids and schema is not None:
                        schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
                        ids[channel.id] = writer.register_channel(
                            channel.topic, channel.message_encoding, schema_id
                        )
                    at_ns = message.log_time + i * span_ns + shift_ns
                    writer.add_message(ids[channel.id], at_ns, message.data, at_ns)
        writer.finish()


def run(*words: object) -> Usage:
    return run_python("-m", "cli", *words)


def run_python(*words: object) -> Usage:
    """Run Python to its end."""
    started = time.perf_counter()
    command = [sys.executable, *map(str, words)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, command)
    return Usage(time.perf_counter() - started, used.ru_utime + used.ru_stime, used.ru_maxrss << 10)


def count_lines(store: Path, failed: list[str], n_frames: int) -> int:
    ((found, n_lines),) = query(store, "SELECT count(*), sum(n_lines) FROM frames").fetchall()
    if found != n_frames:
        failed.append(f"{store.name}: {found} frames instead of {n_frames}")
    return int(n_lines)


if __name__ == "__main__":
    if len(sys.argv) == 3 and sys.argv[2].endswith("rewritten.mcap"):
        repeat(Path(sys.argv[1]), Path(sys.argv[2]), 1, 1, shift_ns=0)
    else:
        sys.exit(main())
