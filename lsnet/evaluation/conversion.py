"""Turn folders of images and masks, as they are published, into an evaluation set: images/ and masks/.

Made for the Ground Truth of Power Line set of Yetgin and Gerek (visible and infrared, 512 px), which the
paper evaluates on. It is in no public repository that was found, and how its files are named is not known:
a mask is found by its name, the image's with or without a word as _gt or mask_, in the same folder or in one
whose name has such a word.
"""

from __future__ import annotations

import re
import shutil
from typing import TYPE_CHECKING

import cv2
import numpy as np

from lsnet.errors import LSNetError
from lsnet.files import make_folder
from lsnet.images import IMAGE_SUFFIXES, load_rgb

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from lsnet.arrays import Mask

_WORDS = r"gt|ground_?truth|masks?|labels?|annotations?"
_NAME = re.compile(rf"^(?:(?:{_WORDS})[_\- ])|(?:[_\- ](?:{_WORDS}))$", re.IGNORECASE)
_FOLDER = re.compile(rf"(?:^|[_\- ])(?:{_WORDS})(?:$|[_\- ])", re.IGNORECASE)


def convert_set(source: Path, output: Path, on_image: Callable[[], None] = lambda: None) -> tuple[int, int]:
    """Copy the images that have a mask, and write the masks as PNG of 0 and 255.

    The names begin with the folders that the image is in, as VL_.

    Args:
        source: Folder of the published set.
        output: Folder to write, which becomes an evaluation set.
        on_image: Called after each image.

    Returns:
        How many images have a mask, and how many were left out since they have none.

    Raises:
        LSNetError: No image has a mask, a mask has another size, or a file cannot be read or written.
    """
    pairs, left_out = pairs_of(source)
    if not pairs:
        raise LSNetError(f"{source}: no image with a mask; give a folder with images and masks named alike")
    for kind in ("images", "masks"):
        make_folder(output / kind)
    for image, mask in pairs:
        name = "_".join([*(p for p in image.parent.relative_to(source).parts if p != "images"), image.stem])
        drawn = read_mask(mask)
        if drawn.shape != load_rgb(image).shape[:2]:
            raise LSNetError(f"{mask}: not the size of {image}; remove one of both")
        shutil.copyfile(image, output / "images" / f"{name}{image.suffix.lower()}")
        cv2.imwrite(str(output / "masks" / f"{name}.png"), drawn.astype(np.uint8) * 255)
        on_image()
    return len(pairs), left_out


def pairs_of(source: Path) -> tuple[list[tuple[Path, Path]], int]:
    """Return the images of a folder and its subfolders with their masks, and the number without one."""
    if not source.is_dir():
        raise LSNetError(f"{source}: not a folder; give the folder of the published set")
    files = sorted(f for f in source.rglob("*") if f.suffix.lower() in IMAGE_SUFFIXES)
    masks = {f for f in files if _is_mask(f, source)}
    by_key: dict[tuple[str, ...], Path] = {_key(f, source): f for f in sorted(masks)}
    images = [f for f in files if f not in masks]
    pairs = [(image, by_key[_key(image, source)]) for image in images if _key(image, source) in by_key]
    return pairs, len(images) - len(pairs)


def read_mask(path: Path) -> Mask:
    """Read (H, W) bool; a mask that is bright in more than half of its pixels is drawn dark on bright."""
    drawn = load_rgb(path).max(axis=2) > 127
    return np.asarray(~drawn if drawn.mean() > 0.5 else drawn, np.bool_)


def _is_mask(file: Path, source: Path) -> bool:
    folders = file.parent.relative_to(source).parts
    return bool(_NAME.search(file.stem)) or any(_FOLDER.search(folder) for folder in folders)


def _key(file: Path, source: Path) -> tuple[str, ...]:
    """Return what image and mask share: the folders without words for masks, and the name without one."""
    folders = (_FOLDER.sub("", p) for p in file.parent.relative_to(source).parts)
    return *(p for p in folders if p and p != "images"), _NAME.sub("", file.stem).lower()
