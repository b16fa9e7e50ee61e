"""Shift and scale single frames so that more of their lines are near known conductors.

Where wires are side by side, as in a bundle, a frame may have been aligned by the next one. Least squares do
not get it back from there.
"""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from inspect_pipeline.inspection.conductors.matching import appear

if TYPE_CHECKING:
    from collections.abc import Sequence

    from inspect_pipeline.arrays import Floats
    from inspect_pipeline.inspection.conductors.layout import Place
    from inspect_pipeline.inspection.conductors.sight import SpanSight

_SHIFTS_M, _SCALED = np.linspace(-1.5, 1.5, 31), np.linspace(-0.12, 0.12, 13)
_NEAR_M, _NEAR_PX = 0.08, 2.0  # standard deviation of lines about their conductors
_MIN_GAIN = 0.08  # of the lines of a frame, by which more must be near a conductor


def realign(sight: SpanSight, places: Sequence[Place], reach: float = 1.0) -> SpanSight:
    """Return the sight with those frames moved that have clearly more lines near a conductor elsewhere.

    reach: times as far, and as coarsely.
    """
    view, n_frames = sight.view, len(sight.rows)
    if not len(view.line) or not places:
        return sight
    frame = sight.lines.frame
    weights = np.bincount(view.line, sight.fine[view.frame, view.bin], len(sight.lines))
    off_m, aside_m, near_m = _offsets(sight, places)
    moves = [(0.0, 1.0), *product((_SHIFTS_M * reach).tolist(), (1 + _SCALED * reach).tolist())]
    scores = np.empty((len(moves), n_frames))
    for i, (shift_m, scale) in enumerate(moves):
        moved_m = shift_m + (scale - 1) * aside_m
        away = np.abs(off_m + moved_m[:, np.newaxis]).min(axis=1) / (near_m * reach)
        scores[i] = np.bincount(frame, weights * np.exp(-0.5 * away**2), n_frames)
    best = np.argmax(scores, axis=0)
    best[scores.max(axis=0) <= scores[0] + _MIN_GAIN * np.bincount(frame, weights, n_frames)] = 0
    shift_m, scale = np.array(moves)[best].T
    side_m = sight.side_m[view.frame]
    across_m = side_m + (view.across_m - side_m) * scale[view.frame] + shift_m[view.frame]
    return sight.move(across_m, shift_m, scale)


def _offsets(sight: SpanSight, places: Sequence[Place]) -> tuple[Floats, Floats, Floats]:
    """Return how far each line is from each conductor (L, K) and its camera (L,), and how near is near."""
    view, n_lines = sight.view, len(sight.lines)
    n_crossings = np.maximum(np.bincount(view.line, minlength=n_lines), 1)
    off_m = view.across_m[:, np.newaxis] - appear(sight, places)[view.frame, :, view.bin]
    mean_m = np.stack([np.bincount(view.line, one, n_lines) for one in off_m.T], axis=1)
    aside_m = np.bincount(view.line, view.across_m - sight.side_m[view.frame], n_lines) / n_crossings
    with np.errstate(divide="ignore"):
        px_in_m = np.bincount(view.line, _NEAR_PX / sight.scale_px[view.frame, view.bin], n_lines)
    return mean_m / n_crossings[:, np.newaxis], aside_m, np.hypot(_NEAR_M, px_in_m / n_crossings)
