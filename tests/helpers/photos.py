"""A folder of photographs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

if TYPE_CHECKING:
    from pathlib import Path


def write_photos(folder: Path, count: int = 4) -> Path:
    """Photographs 0.png, 1.png, ... each all of one grey, 40 times its number."""
    folder.mkdir(parents=True, exist_ok=True)
    for i in range(count):
        cv2.imwrite(str(folder / f"{i}.png"), np.full((100, 140, 3), 40 * i, np.uint8))
    (folder / "notes.txt").write_text("no image")
    return folder
