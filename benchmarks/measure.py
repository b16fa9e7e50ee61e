"""Methods measured against each other: each run in a fresh process, in turn, so that what disturbs one
disturbs all. Figures are ratios within a round, and their median over the rounds."""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence


@dataclass(frozen=True, slots=True)
class Run:
    """One run of a method. The peak is that of the process's own memory above what it had before the run."""

    seconds: float
    peak_bytes: int


def measured(work: Callable[[], object]) -> Run:
    """Run `work` in this process, and return the run."""
    Path("/proc/self/clear_refs").write_text("5")  # reset the peak
    before = _memory_bytes("VmRSS")
    started = time.perf_counter()
    work()
    seconds = time.perf_counter() - started
    return Run(seconds, _memory_bytes("VmHWM") - before)


def print_run(run: Run) -> None:
    """Hand a run to `alternate` in the process that started this one."""
    print(json.dumps(asdict(run)))


def alternate(
    script: str, methods: Iterable[str], n_rounds: int, *, prepare: Callable[[], object] = lambda: None
) -> dict[str, list[Run]]:
    """Return the runs of `script METHOD` by method, each after `prepare`; a first round is not counted."""
    runs: dict[str, list[Run]] = {method: [] for method in methods}
    for i in range(n_rounds + 1):
        for method, done in runs.items():
            prepare()
            command = [sys.executable, script, method]
            output = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout
            if i:
                done.append(Run(**json.loads(output)))
    return runs


def median_ratio(runs: Mapping[str, Sequence[Run]], rival: str, method: str) -> float:
    """Return how many times faster `method` is than `rival`."""
    pairs = zip(runs[rival], runs[method], strict=True)
    return statistics.median(slow.seconds / fast.seconds for slow, fast in pairs)


def print_table(runs: Mapping[str, Sequence[Run]]) -> None:
    """Print a line per method: seconds as median and range, and the highest peak of memory."""
    print(f"{'method':24}  {'median':>10}  {'from':>10}  {'to':>10}  {'memory':>9}")
    for method, done in runs.items():
        seconds = sorted(run.seconds for run in done)
        median_ms, low_ms, high_ms = (
            1e3 * value for value in (statistics.median(seconds), seconds[0], seconds[-1])
        )
        peak_mb = max(run.peak_bytes for run in done) / 2**20
        print(f"{method:24}  {median_ms:7,.2f} ms  {low_ms:7,.2f} ms  {high_ms:7,.2f} ms  {peak_mb:6.1f} MB")


def conclude(name: str, figures: Mapping[str, float], bars: Mapping[str, tuple[float, float]]) -> int:
    """Print one JSON object; the exit code is 1 when a figure is not within its bar (least, most)."""
    failed = [key for key, (least, most) in bars.items() if not least <= figures[key] <= most]
    rounded = {key: round(value, 3) for key, value in figures.items()}
    print(json.dumps({"benchmark": name, **rounded, "failed": failed}))
    return 1 if failed else 0


def _memory_bytes(key: str) -> int:
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) * 1024 for line in lines if line.startswith(key))
