"""Images as the detector takes them: uint8 RGB arrays, or image files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

import cv2
import numpy as np

from lsnet.errors import LSNetError

if TYPE_CHECKING:
    from lsnet.arrays import ImageArray

    ImageInput = str | Path | ImageArray
    ColorOrder = Literal["rgb", "bgr"]

IMAGE_SUFFIXES = {".jpg", ".jpeg", ".png", ".webp", ".bmp", ".tif", ".tiff", ".hdr"}


def load_rgb(path: str | Path) -> ImageArray:
    """Read an image file as uint8 (H, W, 3) RGB, without EXIF rotation; radiance maps are tone-mapped.

    Raises:
        LSNetError: The file is missing or not an image.
    """
    is_radiance = Path(path).suffix.lower() == ".hdr"
    flags = cv2.IMREAD_COLOR_RGB | cv2.IMREAD_IGNORE_ORIENTATION
    flags |= cv2.IMREAD_ANYDEPTH if is_radiance else 0
    try:
        image = cv2.imdecode(np.fromfile(path, np.uint8), flags)
    except (OSError, ValueError, cv2.error) as err:
        raise LSNetError(f"{path}: cannot be read as an image; give a JPEG, PNG or similar") from err
    if image is None:
        raise LSNetError(f"{path}: cannot be read as an image; give a JPEG, PNG or similar")
    if is_radiance:
        bright = max(float(np.percentile(image, 90)), 1e-6)
        image = np.clip((image / bright) ** (1 / 2.2) * 220, 0, 255).astype(np.uint8)
    return np.ascontiguousarray(image)


def open_rgb(image: ImageInput, color: ColorOrder = "rgb") -> ImageArray:
    """Return an image as uint8 (H, W, 3) RGB: a file is read, an array of `color` order is checked.

    Raises:
        LSNetError: The file cannot be read, or the array has another shape or type.
    """
    if isinstance(image, str | Path):
        return load_rgb(image)
    if not isinstance(image, np.ndarray):
        raise LSNetError(f"{type(image).__name__} is not an image; give a path or a uint8 NumPy array")
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8 or not image.size:
        raise LSNetError(f"images must be uint8 arrays (height, width, 3), not {image.dtype} {image.shape}")
    if color not in {"rgb", "bgr"}:
        raise LSNetError(f"no color order {color!r}; choose rgb or bgr")
    return image if color == "rgb" else np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), np.uint8)
