"""Named weights shipped with the package, and the sha256 of each."""

from __future__ import annotations

import json
from pathlib import Path

FOLDER = Path(__file__).parent


def read_checksums() -> dict[str, str]:
    """Return the recorded sha256 of each shipped file, by the name of its weights."""
    names: dict[str, str] = json.loads((FOLDER / "sha256.json").read_text())
    return names


def path_of(name: str) -> Path:
    """Return the file of shipped weights."""
    return FOLDER / f"{name}.safetensors"
