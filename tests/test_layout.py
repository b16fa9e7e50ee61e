"""The size of packages and files, and the names of classes."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[1]
FILES = [
    ROOT / "cli.py",
    *(path for name in ("inspect_pipeline", "lsnet") for path in ROOT.glob(f"{name}/**/*.py")),
]


def test_packages_are_small() -> None:
    sizes = Counter(str(path.parent.relative_to(ROOT)) for path in FILES if path.name != "__init__.py")
    assert sizes.pop("inspect_pipeline") <= 12
    del sizes["inspect_pipeline/commands"]  # a file per command
    assert {name: size for name, size in sizes.items() if size > 18} == {}


def test_files_are_short() -> None:
    lengths = {path.name: len(path.read_text(encoding="utf-8").splitlines()) for path in FILES}
    assert {name: length for name, length in lengths.items() if length > 300} == {}


def test_no_class_name_is_used_twice() -> None:
    names = Counter(
        name
        for path in FILES
        for name in re.findall(r"^class (\w+)", path.read_text(encoding="utf-8"), re.MULTILINE)
    )
    assert [name for name, count in names.items() if count > 1] == []
