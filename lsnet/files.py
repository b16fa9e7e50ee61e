"""Folders, pictures, and digests of files."""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING

import cv2

from lsnet.errors import LSNetError

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from lsnet.arrays import ImageArray


def make_folder(folder: Path) -> None:
    """Create a folder with its parents, unless it exists. Raises LSNetError when it cannot be created."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as err:
        raise LSNetError(f"{folder}: cannot be created as a folder ({err.strerror}); name another") from err


def write_png(path: Path, image: ImageArray) -> None:
    """Write uint8 (H, W, 3) RGB, or (H, W, 4) RGB and alpha. Raises LSNetError when it cannot be written."""
    as_opencv = cv2.COLOR_RGBA2BGRA if image.shape[2] == 4 else cv2.COLOR_RGB2BGR
    if not cv2.imwrite(str(path), cv2.cvtColor(image, as_opencv)):
        raise LSNetError(f"{path}: cannot be written; name another folder")


def digest_of(files: Iterable[Path]) -> str:
    """Return the sha256 of the names and contents of files, in order."""
    digest = hashlib.sha256()
    for file in files:
        content = file.read_bytes()
        digest.update(f"{file.name} {len(content)} ".encode())
        digest.update(content)
    return digest.hexdigest()
