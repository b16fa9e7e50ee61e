"""Levels: an image is looked at in several sizes, and the lines found in them become one set.

Wires are one to forty pixels wide. The network sees best those of a few pixels: the widest of large images
at a coarse level, the thinnest of small images at a fine one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from lsnet.lines.overlap import find_overlaps
from lsnet.lines.polylines import Polylines
from lsnet.preprocess import automatic_scale
from lsnet.segments import Detections, Lines, Segments

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lsnet.arrays import Floats32, Indices, Mask

COARSEST_PX = 1000  # shorter side at the coarsest level: below, kerbs look like wires
FINE, FINE_PX = 1.5, (800, 1000)  # level of images with a shorter side in this range
REACH_PX = 3.0  # at the coarser of two levels: lines this near are one
DOUBLE_SHARE = 0.5  # of the length of a line on others: it is a double


def levels_of(image_size: tuple[int, int]) -> tuple[float, ...]:
    """Return the factors by which an image of (height, width) is resized; the first is nearest to one."""
    short_px = min(image_size)
    base = automatic_scale(image_size)
    fine = (FINE,) if FINE_PX[0] <= short_px < FINE_PX[1] else ()
    coarse = tuple(factor for factor in (0.5, 0.25) if short_px * factor >= COARSEST_PX)
    return (base, *fine, *coarse)


def merge_levels(found: Sequence[Detections], levels: Sequence[float]) -> Detections:
    """Merge detections of one image at several levels, given in its pixels.

    Of lines that lie on each other the one with the higher score is kept. Segments are those of the first
    level, and those of other levels that belong to a line kept.
    """
    if len(found) == 1:
        return found[0]
    points = [line for one in found for line in one.lines.points]
    scores = np.concatenate([one.lines.scores for one in found])
    level_of = np.repeat(np.arange(len(found)), [len(one.lines) for one in found])
    return _select(found, scores, _is_kept(points, scores, level_of, REACH_PX / min(levels)))


def _is_kept(points: Sequence[Floats32], scores: Floats32, level_of: Indices, reach_px: float) -> Mask:
    """(M,) whether each line is no double of a better one of another level; lines are ordered by level."""
    kept = np.zeros(len(points), bool)
    of_levels = {}
    for level in np.unique(level_of):
        own, others = np.flatnonzero(level_of == level), np.flatnonzero(level_of != level)
        lines, other_lines = (Polylines.of([points[i] for i in part.tolist()]) for part in (own, others))
        of_levels[level] = own[0], others, find_overlaps(lines, other_lines, reach_px)
    for i in np.argsort(-scores, kind="stable"):
        first, others, overlaps = of_levels[level_of[i]]
        kept[i] = overlaps.share_of(i - first, kept[others]) < DOUBLE_SHARE
    return kept


def _select(found: Sequence[Detections], scores: Floats32, is_kept: Mask) -> Detections:
    """Join the lines kept of all levels, the best first, with the segments that remain."""
    order = np.flatnonzero(is_kept)[np.argsort(-scores[is_kept], kind="stable")]
    new_number = np.full(len(scores) + 1, -1, np.int32)  # the last for segments without a line
    new_number[order] = np.arange(len(order))
    points = [line for one in found for line in one.lines.points]
    size, parts, line_of, first = found[0].lines.image_size, [], [], 0
    for k, one in enumerate(found):
        own = np.full(len(one.segments), -1) if one.line_of is None else one.line_of
        number = new_number[np.where(own < 0, len(scores), own + first)]
        stays = (number >= 0) | (k == 0)
        parts.append(np.column_stack([one.segments.endpoints, one.segments.scores])[stays])
        line_of.append(number[stays])
        first += len(one.lines)
    rows = np.concatenate(parts).astype(np.float32)
    return Detections(
        Segments(rows[:, :4], rows[:, 4], size),
        Lines(tuple(points[i] for i in order), scores[order], size),
        np.concatenate(line_of).astype(np.int32),
    )
