"""Seeded hostile inputs against the command line: `make attacks SEED=1`.

Every attack is a command in a forked process of its own, in a folder of its own. It fails by a traceback or a
death by a signal, by more than 10 s of processor time or 60 s in all, by more than 1.5 GiB, by changing an
input, or by losing something without a word. Exits with 1 when any does, and prints what to run again.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "helpers"))

import attack_inputs
from fakes import FakeDetector

import cli
import lsnet

if TYPE_CHECKING:
    from attack_inputs import Attack, Templates

MAX_CPU_S, MAX_WALL_S, MAX_BYTES = 10, 60, 1536 << 20
EXIT_CODES = {0, 1, 2, 3, 4, 11, 12}
MAX_STDERR_LINE = 2000


class Outcome(NamedTuple):
    """How a command ended: exit code (negative: the signal), what it printed, and what it used."""

    exit_code: int
    out: str
    err: str
    cpu_s: float
    wall_s: float
    peak_bytes: int


def run(attack: Attack, folder: Path) -> Outcome:
    """Run the command of an attack in a child, with its output in files."""
    out, err = folder / "stdout", folder / "stderr"
    started = time.monotonic()
    pid = os.fork()
    if pid == 0:
        _run_child(attack, folder, out, err)
    status, usage = _wait(pid, started)
    return Outcome(
        os.waitstatus_to_exitcode(status),
        out.read_text(errors="replace"),
        err.read_text(errors="replace"),
        usage.ru_utime + usage.ru_stime,
        time.monotonic() - started,
        usage.ru_maxrss * 1024,
    )


def _run_child(attack: Attack, folder: Path, out: Path, err: Path) -> None:
    """Be the command: never returns."""
    exit_code = 99
    try:
        os.setsid()
        for number, path in ((1, out), (2, err)):
            os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), number)
        resource.setrlimit(resource.RLIMIT_CPU, (MAX_CPU_S * 2, MAX_CPU_S * 2))
        os.chdir(folder / "work")
        if not attack.real_detector:
            lsnet.Detector = FakeDetector
        sys.argv = ["lsnet-pipe", *attack.arguments]
        cli.main()
    except SystemExit as ended:
        exit_code = ended.code if isinstance(ended.code, int) else int(bool(ended.code))
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(exit_code)


def _wait(pid: int, started: float) -> tuple[int, resource.struct_rusage]:
    """Wait for a child, and kill its session when its time is up."""
    while True:
        found, status, usage = os.wait4(pid, os.WNOHANG)
        if found:
            return status, usage
        if time.monotonic() - started > MAX_WALL_S:
            os.killpg(pid, signal.SIGKILL)
        time.sleep(0.005)


def judge(attack: Attack, outcome: Outcome, folder: Path, before: str) -> list[str]:
    """Return the ways in which the program failed."""
    problems = []
    if "Traceback" in outcome.err or outcome.exit_code == 99:
        problems.append("traceback")
    elif outcome.exit_code not in EXIT_CODES:
        problems.append(f"exit code {outcome.exit_code}")
    if outcome.cpu_s > MAX_CPU_S or outcome.wall_s > MAX_WALL_S:
        problems.append(f"slow: {outcome.cpu_s:.0f} s of processor time, {outcome.wall_s:.0f} s")
    if outcome.peak_bytes > MAX_BYTES:
        problems.append(f"memory: {outcome.peak_bytes >> 20} MiB")
    if digest(folder / "in") != before:
        problems.append("changed an input")
    if outcome.exit_code and not outcome.err.strip() and not outcome.out.strip():
        problems.append("failed without a word")
    if any(len(line) > MAX_STDERR_LINE for line in outcome.err.splitlines()):
        problems.append("a line of stderr is too long to read")
    if attack.find_loss and (loss := attack.find_loss(outcome.exit_code, outcome.out, outcome.err)):
        problems.append(f"silent loss: {loss}")
    return problems


def digest(folder: Path) -> str:
    """Return a sha256 of all names and contents below a folder."""
    total = hashlib.sha256()
    for path in sorted(folder.rglob("*")):
        total.update(os.fsencode(path.relative_to(folder)) + oct(path.lstat().st_mode).encode())
        if path.is_file() and not path.is_symlink():
            total.update(path.read_bytes())
    return total.hexdigest()


def attack_all(seed: int, count: int, areas: list[str], only: int | None) -> int:
    """Run the attacks of a seed and print the counts; return how many failed."""
    ended: Counter[tuple[str, str]] = Counter()
    n_failed = 0
    with tempfile.TemporaryDirectory(prefix="attacks") as scratch:
        templates = attack_inputs.make_templates(Path(scratch) / "templates")
        for number in range(count) if only is None else [only]:
            area = areas[number % len(areas)]
            folder = Path(scratch) / str(number)
            attack, outcome, problems = _attack(area, seed, number, folder, templates)
            kind = "FAILED" if problems else "ok" if outcome.exit_code == 0 else "refused"
            ended[area, kind] += 1
            if problems or only is not None:
                print(f"{area} --seed {seed} --only {number}: {'; '.join(problems) or kind}")
                print(f"    lsnet-pipe {' '.join(map(repr, attack.arguments))[:300]}")
                print(f"    {outcome.err.strip()[-600:]}", flush=True)
            n_failed += bool(problems)
            shutil.rmtree(folder)
    for area in areas:
        print(
            f"{area:10} " + "  ".join(f"{kind} {ended[area, kind]}" for kind in ("ok", "refused", "FAILED"))
        )
    print(f"{sum(ended.values())} attacks, {n_failed} failed")
    return n_failed


def _attack(
    area: str, seed: int, number: int, folder: Path, templates: Templates
) -> tuple[Attack, Outcome, list[str]]:
    for name in ("in", "work"):
        (folder / name).mkdir(parents=True)
    rng = np.random.default_rng((seed, number))
    attack = attack_inputs.AREAS[area](rng, folder, templates)
    before = digest(folder / "in")
    outcome = run(attack, folder)
    return attack, outcome, judge(attack, outcome, folder, before)


def main() -> None:
    """Parse the arguments and attack."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--area", action="append", choices=list(attack_inputs.AREAS))
    parser.add_argument("--only", type=int, help="run this attack alone, and show what it prints")
    given = parser.parse_args()
    sys.exit(attack_all(given.seed, given.count, given.area or list(attack_inputs.AREAS), given.only) > 0)


if __name__ == "__main__":
    main()
