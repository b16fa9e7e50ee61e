"""Reading of image files."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from lsnet.errors import LSNetError

if TYPE_CHECKING:
    from pathlib import Path

    from lsnet.arrays import ImageArray

IMAGE_SUFFIXES = {".jpg", ".jpeg", ".png", ".webp", ".bmp", ".tif", ".tiff", ".hdr"}


def load_rgb(path: Path) -> ImageArray:
    """Read an image file as uint8 (H, W, 3) RGB, without EXIF rotation; radiance maps are tone-mapped.

    Raises:
        LSNetError: The file is missing or not an image.
    """
    is_radiance = path.suffix.lower() == ".hdr"
    flags = cv2.IMREAD_COLOR_RGB | cv2.IMREAD_IGNORE_ORIENTATION
    flags |= cv2.IMREAD_ANYDEPTH if is_radiance else 0
    try:
        image = cv2.imdecode(np.fromfile(path, np.uint8), flags)
    except (OSError, cv2.error) as err:
        raise LSNetError(f"{path}: cannot be read as an image; give a JPEG, PNG or similar") from err
    if image is None:
        raise LSNetError(f"{path}: cannot be read as an image; give a JPEG, PNG or similar")
    if is_radiance:
        bright = max(float(np.percentile(image, 90)), 1e-6)
        image = np.clip((image / bright) ** (1 / 2.2) * 220, 0, 255).astype(np.uint8)
    return np.ascontiguousarray(image)
