"""Examples for the line score: proposals in drawn scenes and in photographs without wires."""

from __future__ import annotations

from dataclasses import dataclass, fields
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
from lsnet.synth.clutter.clutter import add_yard
from lsnet.synth.drawing import draw_ground, draw_street, draw_tower, draw_wires
from lsnet.synth.pbr.scenes import laid_over

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from lsnet.arrays import Floats, Floats32, ImageArray, Ints, Rng
    from lsnet.runtime.backend import Backend
    from lsnet.synth.backgrounds import BackgroundPool
    from lsnet.synth.drawing import Sample

SIZES_PX, SIZE_SHARES = (384, 512, 640, 768, 1024), (0.2, 0.3, 0.25, 0.15, 0.1)
SMALL_PX, SMALL_SHARE = (128, 128, 160, 192), 0.15  # enlarged by the detector
WHOLE_SHARE = 0.4  # of the scenes that need no photograph are on one nevertheless
EMPTY_SHARE = 0.15  # of the scenes of wires have none
LEVELS = (1.0, 1.0, 1.0, 1.5, 0.5)  # of scenes that the detector does not enlarge, with their frequency
COARSE_FROM_PX = 640  # the last only from this side on
TOLERANCE_PX = 3.0  # of a place on a wire


class SceneKind(IntEnum):
    """What a scene shows."""

    PHOTOGRAPH = 0  # wires on a photograph as it is
    CLUTTER = 1  # wires over drawn objects that are mistaken for wires
    TOWER = 2  # a tower and the wires that end there
    EMPTY = 3  # a photograph without wires
    STREET = 4  # the wires of a street on a photograph
    RENDERED = 5  # rendered wires, poles and towers


SHARES = {
    SceneKind.PHOTOGRAPH: 0.27,
    SceneKind.CLUTTER: 0.2,
    SceneKind.TOWER: 0.18,
    SceneKind.EMPTY: 0.2,
    SceneKind.STREET: 0.08,
    SceneKind.RENDERED: 0.07,  # if there are any
}
ON_PHOTOGRAPHS = {SceneKind.PHOTOGRAPH, SceneKind.EMPTY, SceneKind.STREET}
CLUTTER_SHARES = {SceneKind.CLUTTER: 1.0, SceneKind.TOWER: 0.3, SceneKind.RENDERED: 0.4}
STRUCTURES = {SceneKind.TOWER: draw_tower, SceneKind.STREET: draw_street}


@dataclass(frozen=True, slots=True, eq=False)
class Examples:
    """N proposals.

    Attributes:
        features: (N, FEATURES).
        priors: (N,) scores by the odds of the segments and the length alone.
        targets: (N,) share of the length that is on a wire.
        lengths_px: (N,).
        kinds: (N,) `SceneKind`.
        scenes: (N,) number of the scene.
        ends: (N, 4) x1, y1, x2, y2.
        image_sizes: (N, 2) height and width of the scene as the network sees it.
        enlargements: (N,) factor by which the scene was enlarged for it.
    """

    features: Floats32
    priors: Floats
    targets: Floats
    lengths_px: Floats
    kinds: Ints
    scenes: Ints
    ends: Floats
    image_sizes: Ints
    enlargements: Floats

    @classmethod
    def joined(cls, parts: Sequence[Examples]) -> Examples:
        """Join the examples of several scenes."""
        return cls(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(cls)))

    def of(self, kinds: Sequence[SceneKind]) -> Examples:
        """Return the examples of some kinds of scenes."""
        keep = np.isin(self.kinds, kinds)
        return Examples(*(getattr(self, field.name)[keep] for field in fields(self)))


@dataclass(frozen=True, slots=True, eq=False)
class LineScenes:
    """Scenes to propose lines in; scene i of a seed is always the same.

    Attributes:
        pool: Photographs without wires.
        pictures: Truths of rendered pictures, as from `rendered_pictures`; may be empty.
        seed: Of the scenes.
    """

    pool: BackgroundPool
    pictures: Sequence[Path] = ()
    seed: int = 0

    def examples(self, index: int, backend: Backend) -> Examples | None:
        """Return the proposals of a network in scene `index`; None if there are none."""
        scene, kind, level = self[index]
        prepared, config = prepare(scene.image, level), ChainingConfig()
        (maps,) = backend.run([prepared.pixels])
        decoded = GridCoder().decode(*maps, prepared.padded_size, config.min_segment_score)
        segments = clip_segments(decoded, prepared.scaled_size)
        proposals, _ = propose_lines(segments, max(prepared.scale, 1.0), config)
        if not len(proposals):
            return None
        height, width = prepared.scaled_size
        factor = np.array([width / scene.image.shape[1], height / scene.image.shape[0]])
        wires = Polylines.of([line * factor for line in scene.lines])
        reach_px = TOLERANCE_PX * max(prepared.scale, 1.0) ** 0.5
        return Examples(
            features_of(prepared.pixels[:height, :width], maps[0], proposals),
            proposals.prior,
            find_overlaps(proposals.polylines, wires, reach_px).shares(),
            proposals.extent_px,
            np.full(len(proposals), kind, np.int64),
            np.full(len(proposals), index, np.int64),
            proposals.ends,
            np.tile(np.array(proposals.image_size, np.int64), (len(proposals), 1)),
            np.full(len(proposals), proposals.enlargement),
        )

    def __getitem__(self, index: int) -> tuple[Sample, SceneKind, float]:
        """Return a scene, its kind, and the factor by which it is resized before detection."""
        rng = np.random.default_rng([self.seed, index])
        shares = np.array(
            [SHARES[kind] * (kind != SceneKind.RENDERED or bool(self.pictures)) for kind in SHARES]
        )
        kind = SceneKind(int(rng.choice(list(SHARES), p=shares / shares.sum())))
        is_small = rng.random() < SMALL_SHARE
        size = int(rng.choice(SMALL_PX) if is_small else rng.choice(SIZES_PX, p=SIZE_SHARES))
        is_whole = kind in ON_PHOTOGRAPHS or rng.random() < WHOLE_SHARE
        ground = draw_ground(
            self.pool,
            rng,
            size,
            is_photograph=is_whole and not is_small,
            has_clutter=rng.random() < CLUTTER_SHARES.get(kind, 0.0),
        )
        if kind == SceneKind.EMPTY:
            add_yard(ground, rng)
        if kind == SceneKind.RENDERED:
            scene = laid_over(self.pictures, index, ground, self.seed, rng)
        else:
            structure = STRUCTURES.get(kind)
            lines = structure(ground, rng) if structure else []
            scene = draw_wires(ground, lines, rng, 0.0 if kind == SceneKind.EMPTY else 1 - EMPTY_SHARE)
        return scene, kind, draw_level(scene.image, rng)


def draw_level(image: ImageArray, rng: Rng) -> float:
    """Return the factor by which an image (H, W, 3) is resized: small ones as always, others at any level."""
    size = image.shape[0], image.shape[1]
    base = automatic_scale(size)
    levels = LEVELS if min(size) >= COARSE_FROM_PX else LEVELS[:-1]
    return base if base > 1 else float(rng.choice(levels))
