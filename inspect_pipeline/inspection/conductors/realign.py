"""Shift single frames to where more of their lines are near known conductors.

Where wires are side by side, as in a bundle, a frame may have been aligned by the next one. Least squares do
not get it back from there.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from inspect_pipeline.inspection.conductors.matching import appear

if TYPE_CHECKING:
    from collections.abc import Sequence

    from inspect_pipeline.arrays import Floats
    from inspect_pipeline.inspection.conductors.layout import Place
    from inspect_pipeline.inspection.conductors.sight import SpanSight

_SHIFTS_M = np.linspace(-1.5, 1.5, 31)
_NEAR_M, _NEAR_PX = 0.08, 2.0  # standard deviation of lines about their conductors
_MIN_GAIN = 0.08  # of the lines of a frame, by which more must be near a conductor


def realign(sight: SpanSight, places: Sequence[Place]) -> SpanSight:
    """Return the sight with those frames shifted that have clearly more lines near a conductor elsewhere."""
    view, n_frames = sight.view, len(sight.rows)
    if not len(view.line) or not places:
        return sight
    weights = np.bincount(view.line, sight.fine[view.frame, view.bin], len(sight.lines))
    off_m, near_m = _offsets(sight, places)
    scores = np.stack(
        [
            np.bincount(sight.lines.frame, weights * _nearness(off_m + shift_m, near_m), n_frames)
            for shift_m in _SHIFTS_M.tolist()
        ],
        axis=1,
    )
    total = np.bincount(sight.lines.frame, weights, n_frames)
    best = np.argmax(scores, axis=1)
    is_better = scores.max(axis=1) > scores[:, len(_SHIFTS_M) // 2] + _MIN_GAIN * total
    shift_m = np.where(is_better, _SHIFTS_M[best], 0.0)
    return sight.move(view.across_m + shift_m[view.frame], shift_m, np.ones(n_frames))


def _offsets(sight: SpanSight, places: Sequence[Place]) -> tuple[Floats, Floats]:
    """Return how far each line is from each conductor on average (L, K), and how near (L,) its own one is."""
    view, n_lines = sight.view, len(sight.lines)
    n_crossings = np.maximum(np.bincount(view.line, minlength=n_lines), 1)
    off_m = view.across_m[:, np.newaxis] - appear(sight, places)[view.frame, :, view.bin]
    mean_m = np.stack([np.bincount(view.line, one, n_lines) for one in off_m.T], axis=1)
    with np.errstate(divide="ignore"):
        px_in_m = np.bincount(view.line, _NEAR_PX / sight.scale_px[view.frame, view.bin], n_lines)
    return mean_m / n_crossings[:, np.newaxis], np.hypot(_NEAR_M, px_in_m / n_crossings)


def _nearness(off_m: Floats, near_m: Floats) -> Floats:
    """Return 1 for a line (L,) at the place of a conductor, towards 0 where it is far from all."""
    return np.asarray(np.exp(-0.5 * (np.abs(off_m).min(axis=1) / near_m) ** 2))
