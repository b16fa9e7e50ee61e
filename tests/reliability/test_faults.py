"""Disks that fill up, break or write half: whichever change of the store fails, the store stays whole.

Also kills at every step that has a name, from the opening of a recording to the publish.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

pytestmark = [pytest.mark.reliability, pytest.mark.timeout(7200)]
HERE = Path(__file__).parent
HELPERS = HERE.with_name("helpers")


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    compiler = shutil.which("cc")
    if not compiler:
        pytest.skip("there is no C compiler")
    target = tmp_path_factory.mktemp("faults") / "faults.so"
    subprocess.run(
        [compiler, "-Wall", "-Werror", "-O1", "-shared", "-fPIC", HERE / "faults.c", "-o", target, "-ldl"],
        check=True,
    )
    return target


@pytest.mark.parametrize("how", ["full", "broken", "short"])
@pytest.mark.parametrize(
    ("command", "step"),
    [
        ("process", 37),
        ("batch", 37),
        pytest.param("process", 1, marks=pytest.mark.slow),
        pytest.param("batch", 1, marks=pytest.mark.slow),
        pytest.param("workers", 3, marks=pytest.mark.slow),
    ],
)
def test_a_disk_that_fails(library: Path, tmp_path: Path, command: str, how: str, step: int) -> None:
    """full: no change is possible from then on; broken: one fails; short: half of one is written."""
    control = tmp_path / "control"
    control.write_bytes(bytes(32))
    report = _run(
        "fault_runs.py",
        tmp_path,
        command,
        how,
        step,
        LD_PRELOAD=library,
        FAULT_ROOT=tmp_path / "stores",
        FAULT_CONTROL=control,
    )
    n_changes, n_met = report.pop("n_changes"), sum(n for ending, n in report.items() if ending != "not met")
    print(f"{command}, {how}: {n_changes} changes, {n_met} of them failed: {report}")
    assert n_changes > (10 if how == "short" else 50)
    assert n_met > n_changes // step - 10
    assert how == "short" or report["exit code 1"] > 0


@pytest.mark.parametrize("command", ["process", "batch"])
@pytest.mark.parametrize("step", [9, pytest.param(1, marks=pytest.mark.slow)])
def test_killed_at_every_named_step(tmp_path: Path, command: str, step: int) -> None:
    """Steps are the calls of the program's functions; those that leave the same on the disk are one."""
    report = _run("step_runs.py", tmp_path, command, step)
    print(f"{command}: {report['n_steps']} steps, {report['n_states']} states, {report['n_kills']} kills")
    wanted = {"open_recording", "Store.write_flight", "Staging.commit", "move_folder_into_place", "publish"}
    assert wanted <= set(report["names"])
    assert report["n_kills"] > 60 // step


def _run(script: str, *arguments: object, **environment: object) -> dict[str, Any]:
    """Return the report that a script prints."""
    folders = os.pathsep.join(map(str, (HELPERS / "light", HERE.parents[1], HELPERS)))
    done = subprocess.run(
        [sys.executable, HERE / script, *map(str, arguments)],
        env={
            **os.environ,
            "PYTHONPATH": folders,
            **{name: str(value) for name, value in environment.items()},
        },
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])
