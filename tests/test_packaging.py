"""The wheel: what it contains, and that it works in an environment of its own, away from the source tree."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


def run(*command: object, cwd: Path) -> str:
    environment = {
        name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "LSNET"))
    }
    done = subprocess.run(
        list(map(str, command)), cwd=cwd, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def contents(wheel: Path) -> set[str]:
    """Return the files of a wheel that are not its metadata."""
    with zipfile.ZipFile(wheel) as archive:
        return {name for name in archive.namelist() if ".dist-info/" not in name}


def tracked() -> set[str]:
    """Return the files of the packages as git tracks them; schemas/ is linked into inspect_pipeline."""
    folders = ("cli.py", "inspect_pipeline", "lsnet", "schemas")
    names = run("git", "ls-files", *folders, cwd=ROOT).split()
    linked = {name for name in names if name != "inspect_pipeline/schemas"}
    return {f"inspect_pipeline/{name}" if name.startswith("schemas/") else name for name in linked}


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_the_wheel_processes_a_recording(tmp_path: Path) -> None:
    run(sys.executable, "-m", "build", "--wheel", "--outdir", tmp_path, ROOT, cwd=tmp_path)
    (wheel,) = tmp_path.glob("*.whl")
    assert contents(wheel) == tracked()
    run(sys.executable, "-m", "venv", tmp_path / "venv", cwd=tmp_path)
    binaries = tmp_path / "venv" / "bin"
    constraints = ROOT / "constraints.txt"
    pip = (binaries / "python", "-m", "pip", "install", "-c", constraints)
    run(*pip, f"{wheel}[openvino]", "pandas", cwd=tmp_path)
    lsnet_pipe = binaries / "lsnet-pipe"
    run(lsnet_pipe, "simulate", "a.mcap", "--seconds", 2, "--size", "640x480", cwd=tmp_path)
    result = json.loads(run(lsnet_pipe, "process", "a.mcap", "--json", cwd=tmp_path))
    assert (result["status"], result["n_frames"]) == ("ok", 4)
    assert result["n_segments"] > 0
    counted = run(lsnet_pipe, "query", "SELECT count(*) AS n FROM segments", "--format", "csv", cwd=tmp_path)
    assert counted.split() == ["n", str(result["n_segments"])]
    assert "WRONG" not in run(lsnet_pipe, "doctor", cwd=tmp_path)
    for example in sorted((ROOT / "examples").glob("*.py")):
        assert run(binaries / "python", example, cwd=tmp_path), example
