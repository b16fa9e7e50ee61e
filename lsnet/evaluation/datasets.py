"""Evaluation sets on disk, recognised by their files.

ID.jpg + ID.boundary.png    contours of each cable, one pixel wide (the PLDU and PLDM sets)
images/ + masks/            a mask of the cables for each image: its name, also with _mask, _gt or _label
anything else               images all with or all without lines: the share with a report is counted
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Literal

import cv2
import numpy as np

from lsnet.errors import LSNetError
from lsnet.evaluation.metrics import PixelTruth
from lsnet.images import IMAGE_SUFFIXES, load_rgb

if TYPE_CHECKING:
    from pathlib import Path

    from lsnet.arrays import ImageArray, Ints, Ints32, Mask

    Kind = Literal["contours", "masks", "plain"]

MAX_CABLE_RADIUS_PX = 14  # a wider region between two contours is ground
MIN_REGION_PX = 12


def images_of(folder: Path) -> tuple[Kind, list[Path]]:
    """Return the kind of set in a folder, and its images by name. Raises LSNetError for an empty one."""
    kind: Kind = "plain"
    if (folder / "masks").is_dir():
        kind, where = "masks", folder / "images"
    else:
        where = folder
        if any(folder.glob("*.boundary.png")):
            kind = "contours"
    files = sorted(
        f for f in where.glob("*") if f.suffix.lower() in IMAGE_SUFFIXES and ".boundary" not in f.name
    )
    if not files:
        raise LSNetError(f"{folder}: no images to evaluate; give a folder of images")
    return kind, files


def load_truth(kind: Kind, image: Path, image_size: tuple[int, int]) -> PixelTruth:
    """Load the truth of an image of (height, width) from a set with pixel truth.

    Raises:
        LSNetError: The file of the truth is missing or has another size.
    """
    mask = load_mask(kind, image, image_size)
    return _from_contours(mask) if kind == "contours" else _from_mask(mask)


@lru_cache(maxsize=256)  # for the methods of a comparison, which are scored one after the other
def load_mask(kind: Kind, image: Path, image_size: tuple[int, int]) -> Mask:
    """Load the pixels of the cables of an image, as `load_truth` does.

    Raises:
        LSNetError: As of `load_truth`.
    """
    path = image.with_name(f"{image.stem}.boundary.png") if kind == "contours" else _mask_of(image)
    try:
        drawn = np.asarray(load_rgb(path).max(axis=2) > 0)
    except LSNetError as err:
        raise LSNetError(f"{path}: missing or not an image; every image of the set needs its truth") from err
    if drawn.shape != image_size:
        raise LSNetError(f"{path}: not the size of its image; give a truth as large as {image.name}")
    return cable_mask(drawn) if kind == "contours" else drawn


def _mask_of(image: Path) -> Path:
    """Return the file of a mask: any image format; the image's name, also with _mask, _gt, _GT or _label."""
    folder = image.parent.parent / "masks"
    names = [image.stem, *(f"{image.stem}_{word}" for word in ("mask", "gt", "GT", "label"))]
    files = (folder / f"{name}{suffix}" for name in names for suffix in (".png", *sorted(IMAGE_SUFFIXES)))
    return next((file for file in files if file.is_file()), folder / f"{image.stem}.png")


def _skeleton(mask: Mask) -> Mask:
    try:
        from skimage.morphology import skeletonize  # noqa: PLC0415 -- an extra
    except ImportError as err:
        raise LSNetError("scikit-image is not installed; pip install 'lsnet-pipe[eval]'") from err
    return np.asarray(skeletonize(mask), np.bool_)  # type: ignore[no-untyped-call]


def _from_mask(mask: Mask) -> PixelTruth:
    half = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5)
    return PixelTruth(mask, _skeleton(mask), np.asarray(half, np.float32))


def _from_contours(mask: Mask) -> PixelTruth:
    """Prune the skeleton where the cable, filled between its contours, is thin for its place."""
    centreline = _skeleton(np.pad(mask, 8, mode="edge"))[8:-8, 8:-8]
    half = cv2.distanceTransform(np.pad(mask, 1, mode="edge").astype(np.uint8), cv2.DIST_L2, 5)[1:-1, 1:-1]
    widest_near = cv2.dilate(half, np.ones((9, 9)))
    return PixelTruth(mask, centreline & (half >= 0.6 * widest_near), np.asarray(half, np.float32))


def cable_mask(contours: Mask) -> Mask:
    """Return the (H, W) mask of cables from their contours.

    The contours divide the image into regions. Starting from the widest region, which is ground, neighbours
    across a contour alternate: ground, cable, ground. Contours that bound no cable region are closed.
    """
    edges = contours.astype(np.uint8)
    count, labels = cv2.connectedComponents(1 - edges, connectivity=4)
    regions = np.asarray(labels, np.int32)
    sizes = np.bincount(regions.ravel(), minlength=count)
    kept = [k for k in range(1, count) if sizes[k] >= MIN_REGION_PX]
    if not kept:
        return np.asarray(cv2.morphologyEx(edges, cv2.MORPH_CLOSE, np.ones((7, 7))) > 0)
    is_cable = _two_colour(edges, regions, sizes, kept)
    mask = np.isin(regions, [k for k in kept if is_cable[k]])
    if mask.any():
        mask |= contours & _grown(mask)
    rest = (contours & ~_grown(mask)).astype(np.uint8)
    round_brush = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (7, 7))
    return np.asarray(mask | (cv2.morphologyEx(rest, cv2.MORPH_CLOSE, round_brush) > 0))


def _grown(mask: Mask) -> Mask:
    """Dilate a mask by two pixels."""
    return np.asarray(cv2.dilate(mask.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0)


def _two_colour(edges: ImageArray, regions: Ints32, sizes: Ints, kept: list[int]) -> dict[int, bool]:
    """Decide which of the kept regions are cable."""
    depth = cv2.distanceTransform(1 - edges, cv2.DIST_L2, 5)
    radius = {k: float(depth[regions == k].max()) for k in kept}
    neighbours = _neighbours(regions, kept)
    is_cable: dict[int, bool] = {}
    for seed in sorted(kept, key=lambda k: -radius[k]):
        if seed in is_cable:
            continue
        is_cable[seed] = False
        queue = [seed]
        while queue:
            here = queue.pop(0)
            for there in sorted(neighbours[here], key=lambda k: -sizes[k]):
                if there not in is_cable:
                    is_cable[there] = radius[there] <= MAX_CABLE_RADIUS_PX and not is_cable[here]
                    queue.append(there)
    return is_cable


def _neighbours(regions: Ints32, kept: list[int]) -> dict[int, set[int]]:
    """Pairs of regions that touch the same contour along more than 8 pixels."""
    found: dict[int, set[int]] = {k: set() for k in kept}
    for k in kept:
        for other, shared in zip(*np.unique(regions[_grown(regions == k)], return_counts=True), strict=True):
            if other != k and other in found and shared > 8:
                found[k].add(int(other))
                found[int(other)].add(k)
    return found
