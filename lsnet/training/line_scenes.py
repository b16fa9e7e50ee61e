"""Examples for the line score: proposals in drawn scenes and in photographs without wires."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING

import numpy as np

from lsnet.grid import GridCoder
from lsnet.lines.chaining import ChainingConfig, propose_lines
from lsnet.lines.features import features_of
from lsnet.lines.overlap import find_overlaps
from lsnet.lines.polylines import Polylines
from lsnet.postprocess import clip_segments
from lsnet.preprocess import automatic_scale, prepare
from lsnet.synth.clutter.borders import road_bend
from lsnet.synth.clutter.clutter import add_clutter
from lsnet.synth.conditions import augment_further
from lsnet.synth.dataset import to_uint8
from lsnet.synth.scene import add_cables, finish_for
from lsnet.synth.towers import add_tower

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lsnet.arrays import Floats, Floats32, ImageArray, Ints, RealArray, Rng
    from lsnet.runtime.backend import Backend
    from lsnet.synth.backgrounds import BackgroundPool

SIZES_PX, SIZE_SHARES = (384, 512, 640, 768, 1024), (0.2, 0.3, 0.25, 0.15, 0.1)
SMALL_PX, SMALL_SHARE = (128, 128, 160, 192), 0.15  # enlarged by the detector
BEND_SHARE = 0.25  # of the photographs get lines along a bend
EMPTY_SHARE = 0.15  # of the scenes without a tower have no wire
LEVELS = (1.0, 1.0, 1.0, 1.5, 0.5)  # of scenes that the detector does not enlarge, with their frequency
COARSE_FROM_PX = 640  # the last only from this side on
TOLERANCE_PX = 3.0  # of a place on a wire


class SceneKind(IntEnum):
    """What a scene shows."""

    PHOTOGRAPH = 0  # wires on a photograph as it is
    CLUTTER = 1  # wires over drawn objects that are mistaken for wires
    TOWER = 2  # a tower and the wires that end there
    EMPTY = 3  # a photograph without wires


SHARES = {SceneKind.PHOTOGRAPH: 0.32, SceneKind.CLUTTER: 0.22, SceneKind.TOWER: 0.23, SceneKind.EMPTY: 0.23}


@dataclass(frozen=True, slots=True, eq=False)
class Examples:
    """N proposals.

    Attributes:
        features: (N, FEATURES).
        targets: (N,) share of the length that is on a wire.
        lengths_px: (N,).
        kinds: (N,) `SceneKind`.
    """

    features: Floats32
    targets: Floats
    lengths_px: Floats
    kinds: Ints

    @classmethod
    def joined(cls, parts: Sequence[Examples]) -> Examples:
        """Join the examples of several scenes."""
        return cls(
            np.concatenate([part.features for part in parts]),
            np.concatenate([part.targets for part in parts]),
            np.concatenate([part.lengths_px for part in parts]),
            np.concatenate([part.kinds for part in parts]),
        )

    def of(self, kinds: Sequence[SceneKind]) -> Examples:
        """Return the examples of some kinds of scenes."""
        keep = np.isin(self.kinds, kinds)
        return Examples(self.features[keep], self.targets[keep], self.lengths_px[keep], self.kinds[keep])


def draw_scene(pool: BackgroundPool, rng: Rng) -> tuple[ImageArray, list[Floats], SceneKind]:
    """Return an image, its wires as (K, 2) points in pixels, and its kind."""
    kind = SceneKind(int(rng.choice(list(SHARES), p=list(SHARES.values()))))
    is_small = rng.random() < SMALL_SHARE
    size = int(rng.choice(SMALL_PX) if is_small else rng.choice(SIZES_PX, p=SIZE_SHARES))
    is_photograph = kind in {SceneKind.PHOTOGRAPH, SceneKind.EMPTY}
    is_whole = not is_small and (is_photograph or rng.random() < 0.4)
    scene = pool.photograph(rng, size) if is_whole else to_uint8(pool.sample(rng, size))
    side = scene.shape[0]
    if kind is SceneKind.CLUTTER or (kind is SceneKind.TOWER and rng.random() < 0.3):
        add_clutter(scene, rng, lambda: to_uint8(pool.sample(rng, side)))
    elif rng.random() < BEND_SHARE:
        road_bend(scene, rng)
    lines: list[Floats] = []
    if kind is SceneKind.TOWER:
        lines += add_tower(scene, rng, finish_for(scene.astype(np.float32), rng))
    image = scene.astype(np.float32)
    if kind is not SceneKind.EMPTY and rng.random() < (0.4 if lines else 1 - EMPTY_SHARE):
        lines += add_cables(image, rng)
    image, lines = augment_further(image, lines, rng)
    return to_uint8(image), lines, kind


def draw_level(image: ImageArray, rng: Rng) -> float:
    """Return the factor by which an image (H, W, 3) is resized: small ones as always, others at any level."""
    size = image.shape[0], image.shape[1]
    base = automatic_scale(size)
    levels = LEVELS if min(size) >= COARSE_FROM_PX else LEVELS[:-1]
    return base if base > 1 else float(rng.choice(levels))


def examples_in(
    image: ImageArray, lines: Sequence[RealArray], kind: SceneKind, level: float, backend: Backend
) -> Examples | None:
    """Return the proposals in an image (H, W, 3) with true lines (K, 2); None if there are no proposals.

    Args:
        image: The scene.
        lines: Points x, y of its wires, pixels.
        kind: What it shows.
        level: Factor by which it is resized.
        backend: The network.
    """
    prepared, config = prepare(image, level), ChainingConfig()
    (maps,) = backend.run([prepared.pixels])
    decoded = GridCoder().decode(*maps, prepared.padded_size, config.min_segment_score)
    segments = clip_segments(decoded, prepared.scaled_size)
    proposals, _ = propose_lines(segments, max(prepared.scale, 1.0), config)
    if not len(proposals):
        return None
    height, width = prepared.scaled_size
    reach_px = TOLERANCE_PX * max(prepared.scale, 1.0) ** 0.5
    factor = np.array([width / image.shape[1], height / image.shape[0]])
    wires = Polylines.of([line * factor for line in lines])
    return Examples(
        features_of(prepared.pixels[:height, :width], maps[0], proposals),
        find_overlaps(proposals.polylines, wires, reach_px).shares(),
        proposals.extent_px,
        np.full(len(proposals), kind, np.int64),
    )
