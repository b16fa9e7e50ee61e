"""Evaluation sets made for tests."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

if TYPE_CHECKING:
    from pathlib import Path


def write_masks(folder: Path) -> Path:
    """One white image of 64 x 80 with a black cable of 4 px, in images/, and where it is, in masks/."""
    for kind in ("images", "masks"):
        (folder / kind).mkdir(parents=True)
    mask = np.zeros((64, 80), np.uint8)
    mask[30:34] = 255
    cv2.imwrite(str(folder / "masks/a.png"), mask)
    cv2.imwrite(str(folder / "images/a.jpg"), np.dstack([255 - mask] * 3))
    return folder
