"""What a command may import: `--help` must not wait for what only the work needs."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import cli

HEAVY = ("torch", "openvino", "duckdb", "mcap", "cv2", "numpy", "rich", "foxglove_schemas_protobuf")
COMMANDS = (
    "",
    "process",
    "query",
    "info",
    "detect",
    "overlay",
    "pack",
    "simulate",
    "doctor",
    "index",
    "model",
    "batch",
    "quarantine",
    "schedule",
    "runs",
    "spans",
    "anomalies",
    "check",
    "flights",
)


@pytest.mark.parametrize("command", COMMANDS)
def test_help_loads_nothing_heavy(command: str) -> None:
    program = (
        "import sys, cli\n"
        "try: cli.main()\n"
        f"finally: print([name for name in {HEAVY!r} if name in sys.modules], file=sys.stderr)"
    )
    child = subprocess.run(
        [sys.executable, "-c", program, *command.split(), "--help"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (child.returncode, child.stderr) == (0, "[]\n")
    assert "Example: lsnet-pipe" in child.stdout


def test_the_command_line_leaves_the_work_to_its_packages() -> None:
    """Import contracts are about packages; the module `cli` is held to them here."""
    tree = ast.parse(Path(cli.__file__).read_text(encoding="utf-8"))
    imported = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    imported |= {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module}
    assert not {name.split(".")[0] for name in imported} & set(HEAVY)
