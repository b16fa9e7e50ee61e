"""The examples, and the Python of the documentation, run as they stand."""

from __future__ import annotations

import re
import runpy
import sys
from pathlib import Path

import pytest
from factories import make_recording, shots
from fakes import FakeDetector

ROOT = Path(__file__).parents[1]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
TEXTS = [(ROOT / name).read_text(encoding="utf-8") for name in ("README.md", "docs/python.md")]
BLOCKS = re.findall(r"```python\n(.*?)```", "".join(TEXTS), re.DOTALL)


@pytest.fixture(autouse=True)
def _light(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, flat_ground: None) -> None:
    monkeypatch.setattr("lsnet.Detector", FakeDetector)
    monkeypatch.setattr("tempfile.mkdtemp", lambda: str(tmp_path))
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_the_example_runs(
    path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if path.stem == "coverage_dataframe":
        pytest.importorskip("pandas")
    monkeypatch.setattr(sys, "argv", [str(path)])
    runpy.run_path(str(path), run_name="__main__")
    outcome = capsys.readouterr()
    assert outcome.out
    assert outcome.err == ""


def test_the_python_of_the_documentation(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    make_recording(tmp_path / "flight.mcap", shots(3))
    for block in BLOCKS:
        exec(compile(block, "python.md", "exec"), {})  # noqa: S102 - our own text
    assert capsys.readouterr().out.startswith("[(3, 0)]\nskipped [(3, 0)]\n")


def test_every_example_is_documented() -> None:
    text = (ROOT / "docs/python.md").read_text(encoding="utf-8")
    assert all(f"(../examples/{path.name})" in text for path in EXAMPLES)
