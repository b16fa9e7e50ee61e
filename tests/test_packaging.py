"""What is shipped: the wheel, in an environment of its own, away from the source tree."""

from __future__ import annotations

import json
import os
import subprocess
import sys
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


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_the_wheel_processes_a_recording(tmp_path: Path) -> None:
    run(sys.executable, "-m", "build", "--wheel", "--outdir", tmp_path, ROOT, cwd=tmp_path)
    (wheel,) = tmp_path.glob("*.whl")
    run(sys.executable, "-m", "venv", tmp_path / "venv", cwd=tmp_path)
    binaries = tmp_path / "venv" / "bin"
    constraints = ROOT / "constraints.txt"
    run(binaries / "python", "-m", "pip", "install", "-c", constraints, f"{wheel}[openvino]", cwd=tmp_path)
    lsnet_pipe = binaries / "lsnet-pipe"
    run(lsnet_pipe, "simulate", "a.mcap", "--seconds", 2, "--size", "640x480", cwd=tmp_path)
    result = json.loads(run(lsnet_pipe, "process", "a.mcap", "--json", cwd=tmp_path))
    assert (result["status"], result["n_frames"]) == ("ok", 4)
    assert result["n_segments"] > 0
    counted = run(lsnet_pipe, "query", "SELECT count(*) AS n FROM segments", "--format", "csv", cwd=tmp_path)
    assert counted.split() == ["n", str(result["n_segments"])]
    assert "WRONG" not in run(lsnet_pipe, "doctor", cwd=tmp_path)
