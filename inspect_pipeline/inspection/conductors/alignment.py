"""Align frames to each other: errors of poses shift, turn and scale all lines of a frame alike."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.ndimage import gaussian_filter1d

if TYPE_CHECKING:
    from collections.abc import Sequence

    from inspect_pipeline.arrays import Floats, Ints
    from inspect_pipeline.inspection.conductors.sight import SpanSight

_CELL_M, _REACH_M = 0.1, 15.0  # of histograms across
_BLURS_M = (0.5, 0.25, 0.15)  # from coarse to fine
_ROUNDS = 3
_SHIFT_PENALTY, _SCALE_PENALTY = 0.05, 0.05  # of the agreement, at one standard deviation
_STAY = 0.05  # of the agreement, by which it must rise before anything is moved
_SCALES, _SCALE_SD = np.linspace(0.76, 1.24, 9), 0.15
_MIN_RUN_BINS = 5  # of a line whose direction counts
_TURN_SD, _TURN_NOISE_M = 0.05, 0.1  # of the direction of all lines of a frame, in m per m; of a line


@dataclass(frozen=True, slots=True)
class _Limits:
    """How far patterns are shifted, and the standard deviation of shifts that are expected."""

    most_m: float
    sd_m: float


_FRAME_LIMITS, _SPAN_LIMITS = _Limits(2.5, 1.5), _Limits(4.5, 2.5)


def align_spans(sights: Sequence[SpanSight]) -> list[SpanSight]:
    """Return sights of spans with the same structures, in which the lines of all frames and spans agree."""
    aligned = [_align_frames(one) for one in sights]
    sizes = [len(one.view.across_m) for one in aligned]
    if sum(sizes) == 0:
        return aligned
    across_m = np.concatenate([one.view.across_m for one in aligned])
    aside_m = np.concatenate([one.side_m[one.view.frame] for one in aligned])
    owner = np.repeat(np.arange(len(sizes)), sizes)
    scale, shift_m = _fit_patterns(across_m, aside_m, owner, len(sizes), _SPAN_LIMITS)
    return [
        _moved(one, np.full(len(one.rows), scale[i]), np.full(len(one.rows), shift_m[i]))
        for i, one in enumerate(aligned)
    ]


def _align_frames(sight: SpanSight) -> SpanSight:
    """Return the sight with the lines of each frame turned along the span, scaled and shifted."""
    if not len(sight.view.across_m):
        return sight
    view, n_frames = sight.view, len(sight.rows)
    still = np.zeros(n_frames)
    turned = view.across_m - _turns(sight)[view.frame] * _ahead_m(sight)
    scale, shift_m = _fit_patterns(turned, sight.side_m[view.frame], view.frame, n_frames, _FRAME_LIMITS)
    return _moved(sight.move(turned, still, still + 1), scale, shift_m)


def _moved(sight: SpanSight, scale: Floats, shift_m: Floats) -> SpanSight:
    """Return the sight with the lines of each frame scaled (N,) about the camera, then shifted (N,)."""
    frame = sight.view.frame
    aside_m = sight.side_m[frame]
    across_m = aside_m + (sight.view.across_m - aside_m) * scale[frame] + shift_m[frame]
    return sight.move(across_m, shift_m, scale)


def _ahead_m(sight: SpanSight) -> Floats:
    """Return how far ahead of the camera (C,) crossings are."""
    return np.asarray(sight.axis.bins_m[sight.view.bin] - sight.from_m[sight.view.frame])


def _turns(sight: SpanSight) -> Floats:
    """Return the common direction (N,) of the lines of each frame, in metres across per metre along."""
    view, n_lines = sight.view, len(sight.lines)
    ahead_m = _ahead_m(sight)
    count = np.bincount(view.line, minlength=n_lines)
    mean_x, mean_y = (
        np.bincount(view.line, values, n_lines) / np.maximum(count, 1) for values in (ahead_m, view.across_m)
    )
    dx, dy = ahead_m - mean_x[view.line], view.across_m - mean_y[view.line]
    spread = np.bincount(view.line, dx * dx, n_lines)
    slope = np.bincount(view.line, dx * dy, n_lines) / np.maximum(spread, 1e-9)
    usable = np.flatnonzero((count >= _MIN_RUN_BINS) & (spread > 0))
    turns = np.zeros(len(sight.rows))
    frames = sight.lines.frame[usable]
    for frame in np.unique(frames).tolist():
        own = usable[frames == frame]
        order = own[np.argsort(slope[own])]
        total = np.cumsum(spread[order])
        median = slope[order[np.searchsorted(total, total[-1] / 2)]]
        turns[frame] = median * total[-1] / (total[-1] + (_TURN_NOISE_M / _TURN_SD) ** 2)
    return turns


def _fit_patterns(
    across_m: Floats, aside_m: Floats, group: Ints, n_groups: int, limits: _Limits
) -> tuple[Floats, Floats]:
    """Return scales and shifts (G,) under which the positions of all groups agree best.

    across_m, aside_m, group (C,): positions of crossings and of their cameras, and their groups.
    """
    scaled = [aside_m + (across_m - aside_m) * scale for scale in _SCALES]
    banks = np.stack([_histograms(one, group, n_groups, limits) for one in scaled], axis=1)  # (G, S, cells)
    reach = round(limits.most_m / _CELL_M)
    steps = np.arange(-reach, reach + 1)
    penalties = _SHIFT_PENALTY * (steps * _CELL_M / limits.sd_m) ** 2
    penalties = penalties + _SCALE_PENALTY * ((_SCALES - 1) / _SCALE_SD)[:, np.newaxis] ** 2
    penalties += np.where(
        (steps == 0) & (np.arange(len(_SCALES)) == len(_SCALES) // 2)[:, np.newaxis], 0.0, _STAY
    )
    chosen = np.tile((len(_SCALES) // 2, 0), (n_groups, 1))
    shown = np.flatnonzero(banks[:, chosen[0, 0]].any(axis=1)).tolist()
    for blur_m in _BLURS_M:
        soft = gaussian_filter1d(banks, blur_m / _CELL_M, axis=2)
        for _ in range(_ROUNDS):
            _fit_round(soft, chosen, shown, steps, penalties)
    return _SCALES[chosen[:, 0]], chosen[:, 1] * _CELL_M


def _fit_round(soft: Floats, chosen: Ints, shown: Sequence[int], steps: Ints, penalties: Floats) -> None:
    """Update the scale and the shift of each group from those of all others."""

    def placed(i: int) -> Floats:
        return np.roll(soft[i, chosen[i, 0]], chosen[i, 1])

    total = np.sum([placed(i) for i in shown], axis=0)
    shifted = np.arange(steps[0], steps[-1] + len(total))  # of all windows, one after the other
    for i in shown:
        total -= placed(i)
        windows = sliding_window_view(total.take(shifted, mode="wrap"), len(total))
        agreement = soft[i] @ windows.T
        scores = agreement / max(float(agreement.max()), 1e-12) - penalties
        scale, step = np.unravel_index(np.argmax(scores), scores.shape)
        chosen[i] = scale, steps[step]
        total += placed(i)


def _histograms(across_m: Floats, group: Ints, n_groups: int, limits: _Limits) -> Floats:
    """Return the share of crossings (G, cells) of each group by position."""
    n_cells = round(2 * (_REACH_M + limits.most_m) / _CELL_M)
    cells = np.clip(np.round((across_m + n_cells * _CELL_M / 2) / _CELL_M), 0, n_cells - 1).astype(np.int64)
    counts = np.bincount(group * n_cells + cells, minlength=n_groups * n_cells).reshape(n_groups, n_cells)
    return np.asarray(counts / np.maximum(counts.sum(axis=1, keepdims=True), 1.0))
