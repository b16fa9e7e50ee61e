"""Rendered cables over photographs as training data, as in the paper (Section III-A)."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import cv2
import numpy as np

from lsnet.errors import LSNetError
from lsnet.synth.backgrounds import part_of
from lsnet.synth.conditions import augment_further, cable_shadows
from lsnet.synth.drawing import Sample, draw_ground, to_uint8
from lsnet.synth.geometric import crops_and_flips, over, rotate, zoom

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from lsnet.arrays import FloatImage, Floats, ImageArray
    from lsnet.synth.backgrounds import BackgroundPool, Part
    from lsnet.synth.geometric import Labelled


BACKGROUNDS = 5  # per crop, as in the paper
SHADOW_SHARE = 0.2  # of images in which cables cast shadows
MOVE_SHARE = 0.25  # of images that are zoomed, and of those that are rotated


class RenderedScenes:
    """Pictures of `model synth`, as five crops and their flips, each over five backgrounds.

    They are zoomed, rotated and augmented on the fly. Sample i is always the same. All pictures, crops and
    backgrounds are used before any is repeated with another augmentation.

    Args:
        pictures: Their truths, as from `rendered_pictures`.
    """

    def __init__(
        self, pictures: Sequence[Path], pool: BackgroundPool, size: int = 384, seed: int = 0
    ) -> None:
        self.size, self._pool, self._seed = size, pool, seed
        self._pictures = pictures

    def __getitem__(self, index: int) -> Sample:
        rng = np.random.default_rng([self._seed, index])
        ground = draw_ground(self._pool, rng, self.size, is_photograph=False, has_clutter=True)
        return laid_over(self._pictures, index, ground, self._seed, rng)


def laid_over(
    pictures: Sequence[Path], index: int, ground: ImageArray, seed: int, rng: np.random.Generator
) -> Sample:
    """Lay one of the pictures, as `cropped` chooses it, over a square ground (H, H, 3), and augment both.

    Its cables are lines; poles, towers and strings of insulators are not.
    """
    cables, lines = cropped(pictures, index, ground.shape[0], seed)
    for move in (zoom, rotate):
        if rng.random() < MOVE_SHARE:
            cables, lines = move(cables, lines, rng)
    below = ground.astype(np.float32)
    if rng.random() < SHADOW_SHARE:
        below = cable_shadows(below, lines, rng)
    image, lines = augment_further(composed(cables, below), lines, rng)
    return Sample(to_uint8(image), lines)


def rendered_pictures(folder: Path, part: Part = "all") -> list[Path]:
    """Return the truths of the pictures of `model synth`. Raises LSNetError when there are none."""
    truths = sorted(folder.glob("[0-9]*.json"))
    if not truths:
        raise LSNetError(
            f"{folder}: no rendered pictures in this folder; make some with lsnet-pipe model synth"
        )
    return part_of(truths, part)


def cropped(pictures: Sequence[Path], index: int, size: int, seed: int) -> Labelled:
    """Return one of the crops and flips of one of the pictures, scaled to (size, size), with its lines.

    Each picture comes once in as many samples as there are pictures; the crop changes when each has been over
    five backgrounds. The crops of a picture do not depend on the background.
    """
    which, turn = index % len(pictures), index // len(pictures)
    versions = crops_and_flips(*_load(pictures[which]), np.random.default_rng([seed, 1, which]))
    return _fitted(*versions[turn // BACKGROUNDS % len(versions)], size)


def _load(truth: Path) -> Labelled:
    """Return (H, W, 4) premultiplied colours, so that interpolation blends correctly; and the lines."""
    try:
        lines = [np.array(line, float) for line in json.loads(truth.read_text())["lines"]]
    except (OSError, ValueError, LookupError, TypeError, RecursionError) as err:
        raise LSNetError(
            f"{truth}: not the truth of a rendered picture ({err}); remove it and its PNG"
        ) from err
    pixels = cv2.imread(str(truth.with_suffix(".png")), cv2.IMREAD_UNCHANGED)
    if pixels is None or pixels.ndim != 3 or pixels.shape[2] != 4:
        raise LSNetError(f"{truth}: its PNG is missing or has no alpha; remove it, and render it again")
    image = cv2.cvtColor(pixels, cv2.COLOR_BGRA2RGBA).astype(np.float32)
    image[..., :3] *= image[..., 3:] / 255
    return image, lines


def _fitted(cables: FloatImage, lines: list[Floats], size: int) -> Labelled:
    """Scale to (size, size); crops are square like the picture."""
    factor = np.array([size / cables.shape[1], size / cables.shape[0]])
    how = cv2.INTER_AREA if factor[0] < 1 else cv2.INTER_LINEAR
    scaled = cv2.resize(cables, (size, size), interpolation=how)
    return np.asarray(scaled, np.float32), [line * factor for line in lines]


def composed(cables: FloatImage, ground: FloatImage) -> FloatImage:
    """Lay premultiplied cables (H, W, 4) over a ground (H, W, 3)."""
    alpha = cables[..., 3:] / 255
    return over(np.concatenate([cables[..., :3] / np.maximum(alpha, 1e-3), alpha], axis=2), ground)
