"""Recordings of JPEG images through `lsnet-pipe process` and `batch`, from start to published index.

    python benchmarks/bench_process.py [--sizes 1920x1080 3840x2160] [--frames 10] [--copies 4] [--jobs 2]

Simulated images are repeated, since drawing them takes longer than detecting in them; recordings of larger
images are shorter. In the same rounds the mcap package rewrites the recording, message by message, without
looking at the images. `batch` processes four recordings, together as long as that of `process`, by one
worker, by several, and by one on one core. Each run is reported on stderr when it ends. Wall times depend on
what else runs; the CPU time of all processes hardly does. Memory is the greatest sum of the proportional
sizes of all processes. Checks: every frame has its row, batches find the same number of lines by any workers.
The last line is one JSON object.
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
from collections import defaultdict
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from bench_speed import print_machine
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from inspect_pipeline import SimulationOptions, process, query, simulate
from inspect_pipeline.detection import StageTimes
from lsnet import Detector

if TYPE_CHECKING:
    from collections.abc import Iterator

FPS = 5.0


@dataclass(frozen=True, slots=True)
class Usage:
    """Wall and CPU seconds of a process and its children, and the peak of their sum, bytes."""

    wall_s: float
    cpu_s: float
    peak_bytes: int


def main() -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--sizes", nargs="*", default=["1920x1080", "3840x2160"])
    parser.add_argument("--frames", type=int, default=10, help="that are simulated")
    parser.add_argument("--copies", type=int, default=4, help="of them in a recording of 1080p")
    parser.add_argument("--rounds", type=int, default=2)
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
    width, height = map(int, size.split("x"))
    copies = max(1, round(arguments.copies * 1920 * 1080 / (width * height)))
    source, n_frames = folder / f"{size}.mcap", arguments.frames * copies
    simulate(source, SimulationOptions(seconds=arguments.frames / FPS, fps=FPS, image_size=(height, width)))
    repeat(source, folder / "long.mcap", copies, arguments.frames, shift_ns=0)
    n_copies = max(1, copies // 4)  # in each recording of a batch
    for i in range(4):
        repeat(source, inbox / f"{i}.mcap", n_copies, arguments.frames, shift_ns=i * 10**12)
    n_in_batch = 4 * n_copies * arguments.frames
    rounds: defaultdict[str, list[Usage]] = defaultdict(list)
    profiles = []
    for i in range(arguments.rounds):
        store = folder / f"store{size}{i}"
        rounds["process"].append(run("process", folder / "long.mcap", "--store", store))
        count_lines(store, failed, n_frames)
        rounds["mcap rewrite"].append(run_python(__file__, folder / "long.mcap", folder / "rewritten.mcap"))
        profiles.append(profile(folder / "long.mcap", folder / f"profiled{size}{i}"))
        note(f"process, {n_frames} frames", rounds["process"][-1])
        n_lines = set()
        for name, jobs, n_cores in (
            ("batch 1", 1, None),
            ("batch N", arguments.jobs, None),
            ("one core", 1, 1),
        ):
            store = folder / f"store{size}{i}{name}"
            with on_cores(n_cores):
                rounds[name].append(run("batch", inbox, "--store", store, "--jobs", jobs, "--settle", 0))
            n_lines.add(count_lines(store, failed, n_in_batch))
            note(f"{name}, {n_in_batch} frames", rounds[name][-1])
        if len(n_lines) > 1:
            failed.append(f"{size}: batches find {sorted(n_lines)} lines")
        print(f"round {i + 1} of {arguments.rounds} at {size}", file=sys.stderr, flush=True)
    return table(size, rounds, n_frames, n_in_batch) | ratios(rounds, profiles)


def note(what: str, used: Usage) -> None:
    """Report a run that has ended: all of them take minutes."""
    print(f"{what}: {used.wall_s:.1f} s", file=sys.stderr, flush=True)


def table(size: str, rounds: dict[str, list[Usage]], n_frames: int, n_in_batch: int) -> dict[str, float]:
    figures = {}
    print(f"{size:12} {'frames/s':>9} {'CPU ms/frame':>13} {'peak MiB':>9}")
    for name, done in rounds.items():
        frames = n_frames if name in ("process", "mcap rewrite") else n_in_batch
        per_s = statistics.median(frames / each.wall_s for each in done)
        cpu_ms = statistics.median(1e3 * each.cpu_s / frames for each in done)
        peak = max(each.peak_bytes for each in done) / 2**20
        print(f"{name:12} {per_s:9.2f} {cpu_ms:13.1f} {peak:9.0f}", flush=True)
        figures |= {f"{name} frames_per_s": round(per_s, 2), f"{name} cpu_ms": round(cpu_ms, 2)}
        figures[f"{name} peak_mib"] = round(peak)
    return figures


def ratios(rounds: dict[str, list[Usage]], profiles: list[dict[str, float]]) -> dict[str, float]:
    """Print how well the cores are used, and the seconds to the first frame."""

    def faster(than: str) -> float:
        pairs = zip(rounds[than], rounds["batch N"], strict=True)
        return statistics.median(slow.wall_s / fast.wall_s for slow, fast in pairs)

    figures = {
        "batch N over batch 1": faster("batch 1"),
        "batch N over one core": faster("one core"),
        "wall over CPU of decode and infer, all cores": statistics.median(p["wall_of_cpu"] for p in profiles),
        "start to first frame, s": statistics.median(p["first_frame_s"] for p in profiles),
    }
    for name, value in figures.items():
        print(f"{name:46} {value:6.2f}", flush=True)
    return {name: round(value, 3) for name, value in figures.items()}


@contextmanager
def on_cores(n_cores: int | None) -> Iterator[None]:
    """Hold processes that are started in the block to some cores."""
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, sorted(cores)[:n_cores])
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)


def profile(recording: Path, store: Path) -> dict[str, float]:
    """Process a recording in a process of its own; see `print_profile`."""
    command = [sys.executable, __file__, "profile", str(recording), str(store), str(time.time())]
    found: dict[str, float] = json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
    return found


def print_profile(recording: str, store: str, started_s: str) -> None:
    """Print the seconds from the start to the first frame, and the wall time over the time of the cores."""
    first: list[float] = []
    detector, times = Detector.load(), StageTimes()
    process(recording, store, detector, on_progress=lambda _: first.append(time.time()), times=times)
    stages = times.stages()
    cpu_s = sum(stages[stage][1] for stage in ("decode", "infer"))
    shares = {
        "first_frame_s": first[0] - float(started_s),
        "wall_of_cpu": times.wall_s * len(os.sched_getaffinity(0)) / cpu_s,
    }
    print(json.dumps(shares))


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
    peak_bytes, pid = 0, 0
    while not pid:
        peak_bytes = max(peak_bytes, tree_bytes(process.pid))
        time.sleep(0.05)
        pid, status, used = os.wait4(process.pid, os.WNOHANG)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, command)
    return Usage(time.perf_counter() - started, used.ru_utime + used.ru_stime, peak_bytes)


def tree_bytes(pid: int) -> int:
    """Return the memory of a process and all below it; what several share counts once."""
    total = 0
    with suppress(OSError):  # it can end meanwhile
        rollup = Path(f"/proc/{pid}/smaps_rollup").read_text()
        total += sum(int(line.split()[1]) << 10 for line in rollup.splitlines() if line.startswith("Pss:"))
        for children in Path(f"/proc/{pid}/task").glob("*/children"):
            total += sum(tree_bytes(int(child)) for child in children.read_text().split())
    return total


def count_lines(store: Path, failed: list[str], n_frames: int) -> int:
    ((found, n_lines),) = query(store, "SELECT count(*), sum(n_lines) FROM frames").fetchall()
    if found != n_frames:
        failed.append(f"{store.name}: {found} frames instead of {n_frames}")
    return int(n_lines)


if __name__ == "__main__":
    if len(sys.argv) == 3 and sys.argv[2].endswith("rewritten.mcap"):
        repeat(Path(sys.argv[1]), Path(sys.argv[2]), 1, 1, shift_ns=0)
    elif sys.argv[1:2] == ["profile"]:
        print_profile(*sys.argv[2:])
    else:
        sys.exit(main())
