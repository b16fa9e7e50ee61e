"""What a command may import: `--help` must not wait for what only the work needs."""

from __future__ import annotations

import ast
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from command_line import all_commands

import cli

HEAVY = ("torch", "openvino", "duckdb", "mcap", "cv2", "numpy", "rich", "ray", "foxglove_schemas_protobuf")
COMMANDS = all_commands()


# One process for all: imports of one command remain for those that follow, and are reported with them.
PROGRAM = f"""
import contextlib, io, json, sys
import cli
reports = {{}}
for command in {COMMANDS!r}:
    sys.argv = ["lsnet-pipe", *command.split(), "--help"]
    with contextlib.redirect_stdout(io.StringIO()) as out:
        try:
            cli.main()
        except SystemExit as ended:
            reports[command] = ended.code, out.getvalue(), [name for name in {HEAVY!r} if name in sys.modules]
print(json.dumps(reports))
"""


@pytest.fixture(scope="module")
def reports() -> dict[str, tuple[int, str, list[str]]]:
    """Exit code, help and heavy modules of each command."""
    child = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True)
    assert child.stderr == ""
    return json.loads(child.stdout)


@pytest.mark.parametrize("command", COMMANDS)
def test_help_loads_nothing_heavy(command: str, reports: dict[str, tuple[int, str, list[str]]]) -> None:
    exit_code, text, heavy = reports[command]
    assert (exit_code, heavy) == (0, [])
    assert re.search(rf"^(  Example: |    )lsnet-pipe {command}", text, re.MULTILINE)


def test_the_command_line_leaves_the_work_to_its_packages() -> None:
    """Import contracts are about packages; the module `cli` is held to them here."""
    tree = ast.parse(Path(cli.__file__).read_text(encoding="utf-8"))
    imported = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    imported |= {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module}
    assert not {name.split(".")[0] for name in imported} & set(HEAVY)


def test_skipping_recordings_loads_neither_torch_nor_scipy() -> None:
    """They take seconds to import, every night."""
    program = """
import sys
import inspect_pipeline.batch.run, inspect_pipeline.pipeline, inspect_pipeline.publishing, lsnet.description
print([name for name in ("torch", "scipy", "pyarrow", "pyproj", "rich", "jinja2") if name in sys.modules])
"""
    child = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert child.stdout.strip() == "[]"
