"""Folders that commands write into."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lsnet.errors import LSNetError

if TYPE_CHECKING:
    from pathlib import Path


def make_folder(folder: Path) -> None:
    """Make a folder with its parents, unless it is there. Raises LSNetError when it cannot be made."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as err:
        raise LSNetError(f"{folder}: cannot be made a folder ({err.strerror}); name another") from err
