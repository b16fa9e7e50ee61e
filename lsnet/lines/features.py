"""Features of proposals that the learned line score rates.

A wire has the same ground on both sides, keeps its own tone while the ground changes, and is a ridge along
its whole length. A kerb has a different ground on each side, a joint follows the tone of its ground, and
other steel crosses steel.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from lsnet.lines.strips import ACROSS_PX, ALONG, BEYOND, cut_strips, is_inside
from lsnet.lines.surroundings import count_neighbours

if TYPE_CHECKING:
    from lsnet.arrays import Floats, Floats32, ImageArray, Mask, RealArray
    from lsnet.lines.proposals import Proposals

FEATURES = 180
MIDDLE = len(ACROSS_PX) // 2
LINE = slice(BEYOND, BEYOND + ALONG)
ON_LINE = slice(MIDDLE - 1, MIDDLE + 2)
LUMA = np.array([0.299, 0.587, 0.114], np.float32)
SIDES_PX = ((2, 3), (4, 6), (6, 9), (9, 14), (14, 24), (24, 40))  # distances of the ground that is compared
DETAILED = [1, 3]  # of these distances
SIDE_MEANS = np.stack(  # (O, 2 D) weights that average the ground of one side, then of the other, by distance
    [
        inside / inside.sum()
        for side in (-ACROSS_PX, ACROSS_PX)
        for inside in ((side >= near) & (side <= far) for near, far in SIDES_PX)
    ],
    axis=1,
).astype(np.float32)
CELL_STEP_PX = 16


def features_of(image: ImageArray, cell_scores: Floats32, proposals: Proposals) -> Floats32:
    """Return (C, FEATURES) features of C proposals.

    Args:
        image: The network's input, (H, W, 3), without padding.
        cell_scores: (R, K) scores of the cells of the interleaved grids.
        proposals: Lines in the pixels of the image.
    """
    strips, places = cut_strips(image, proposals.polylines)
    inside = is_inside(places, proposals.image_size)
    cells = _scores_along(cell_scores, places)
    parts = [
        *_profiles(strips),
        *_ridges(strips),
        *_ends(inside, cells),
        *_textures(strips),
        _shapes(proposals),
    ]
    return np.concatenate(parts, axis=1, dtype=np.float32)


def _scores_along(scores: Floats32, places: Floats) -> Floats32:
    """(C, T) second highest of the scores of the four cells around each place (C, T, 2)."""
    rows, columns = scores.shape
    x = np.clip(places[..., 0] / CELL_STEP_PX - 1, 0, columns - 1)
    y = np.clip(places[..., 1] / CELL_STEP_PX - 1, 0, rows - 1)
    left, top = np.floor(x).astype(np.intp), np.floor(y).astype(np.intp)
    right, bottom = np.minimum(left + 1, columns - 1), np.minimum(top + 1, rows - 1)
    around = np.stack([scores[top, left], scores[top, right], scores[bottom, left], scores[bottom, right]])
    return np.asarray(np.sort(around, axis=0)[-2], np.float32)


def _mirrored(values: RealArray) -> tuple[RealArray, RealArray]:
    """The values (C, O, ...) on one side and on the other, both from the line outwards."""
    return values[:, MIDDLE + 1 :], values[:, :MIDDLE][:, ::-1]


def _profiles(strips: Floats32) -> list[RealArray]:
    """Mean profile across the line: symmetric and antisymmetric part, colour, spread along the line."""
    line = strips[:, LINE]
    grey = line @ LUMA
    contrast = grey.std(axis=(1, 2)) + 4
    profile, spread = grey.mean(axis=1), grey.std(axis=1) / contrast[:, None]
    relative = (profile - profile.mean(axis=1, keepdims=True)) / contrast[:, None]
    one, other = _mirrored(relative)
    red, green = _mirrored(line.mean(axis=1))
    near = [spread[:, MIDDLE]]
    near += [(spread[:, MIDDLE + k] + spread[:, MIDDLE - k]) / 2 for k in (1, 2, 3, 5, 7, 9, 12)]
    return [
        np.abs((one + other) / 2 - relative[:, MIDDLE : MIDDLE + 1]),
        np.abs(one - other),
        np.abs(red - green).max(axis=-1) / 30,
        np.stack(near, axis=1),
        np.stack([np.log(contrast), profile.mean(axis=1) / 255], axis=1),
    ]


def _ridges(strips: Floats32) -> list[RealArray]:
    """How far the line stands out from the ground at D distances, on both sides at once."""
    count, n_distances = len(strips), len(SIDES_PX)
    grey = strips @ LUMA
    tone, colour = grey[..., ON_LINE].mean(axis=-1), strips[:, LINE, ON_LINE].mean(axis=2)
    ground = (grey @ SIDE_MEANS).reshape(count, -1, 2, n_distances).transpose(2, 3, 0, 1)
    ground_colours = np.swapaxes(strips[:, LINE], 2, 3) @ SIDE_MEANS
    ground_colours = ground_colours.reshape(count, ALONG, 3, 2, n_distances).transpose(3, 4, 0, 1, 2)
    sign = np.sign((tone - ground.mean(axis=0))[..., LINE].mean(axis=-1, keepdims=True))
    sign[sign == 0] = 1
    height = np.minimum(*(sign * (tone - ground)))
    near = ground[..., LINE]
    ridges, colours = (
        _ridge(tone[:, LINE], near, height[..., LINE]),
        _ridge_colours(colour, ground_colours, near),
    )
    details = _ridge_details(tone[:, LINE], near[:, DETAILED], height[DETAILED])
    parts: list[RealArray] = []
    for k in range(n_distances):
        parts += [ridges[k], colours[k]]
        parts += [details[DETAILED.index(k)]] if k in DETAILED else []
    spreads = [tone[:, LINE].std(axis=1), colour.std(axis=1).max(axis=-1)]
    return [*parts, np.stack(spreads, axis=1) / 20]


def _ridge(tone: RealArray, ground: RealArray, height: RealArray) -> RealArray:
    """(D, C, 8) from tones of the line (C, T) and both grounds (2, D, C, T), and heights of the ridge."""
    difference, contrast = ground[0] - ground[1], tone - ground.mean(axis=0)
    mean_contrast = np.abs(contrast.mean(axis=-1))
    values = [
        np.abs(difference).mean(axis=-1) / 20,
        np.abs(difference.mean(axis=-1)) / 20,
        mean_contrast / 20,
        mean_contrast / (contrast.std(axis=-1) + 2),
        (height > 2).mean(axis=-1),
        (height > 8).mean(axis=-1),
        np.quantile(height, 0.2, axis=-1) / 20,
        height.mean(axis=-1) / 20,
    ]
    return np.stack(values, axis=-1)


def _ridge_colours(colour: RealArray, ground: RealArray, tones: RealArray) -> RealArray:
    """(D, C, 5) from colours of the line (C, T, 3), of both grounds (2, D, C, T, 3), tones of these."""
    middle, spreads = ground.mean(axis=0), tones.std(axis=-1) / 20
    apart = np.abs(colour - ground).min(axis=0).max(axis=-1)
    values = [
        np.abs((ground[0] - ground[1]).mean(axis=-2)).max(axis=-1) / 20,
        np.abs((colour - middle).mean(axis=-2)).max(axis=-1) / 20,
        apart.mean(axis=-1) / 20,
        spreads.sum(axis=0),
        spreads.min(axis=0),
    ]
    return np.stack(values, axis=-1)


def _ridge_details(tone: RealArray, ground: RealArray, height: RealArray) -> RealArray:
    """(D, C, 7): whether the line follows the ground's tone, its ridge by quarters and beyond the ends."""
    own = tone - tone.mean(axis=-1, keepdims=True)
    below = ground.mean(axis=0)
    below = below - below.mean(axis=-1, keepdims=True)
    power = (own * own).mean(axis=-1) * (below * below).mean(axis=-1) + 4
    quarters = (height[..., LINE] > 3).reshape(*height.shape[:2], 4, -1).mean(axis=-1)
    beyond = [height[..., :BEYOND].mean(axis=-1) / 20, height[..., BEYOND + ALONG :].mean(axis=-1) / 20]
    follows = (own * below).mean(axis=-1) / np.sqrt(power)
    return np.concatenate([follows[..., None], np.sort(quarters, axis=-1), _in_order(*beyond)], axis=-1)


def _ends(inside: Mask, cells: Floats32) -> list[RealArray]:
    """How much of the image lies beyond the ends, and what the network says along the line and there."""
    line = cells[:, LINE]
    levels = [line.mean(axis=1), *np.quantile(line, (0.1, 0.25, 0.5, 0.75), axis=1)]
    return [
        _in_order(*(part.mean(axis=1) for part in (inside[:, :BEYOND], inside[:, BEYOND + ALONG :]))),
        np.stack(levels, axis=1),
        _in_order(*(part.max(axis=1) for part in (cells[:, :BEYOND], cells[:, BEYOND + ALONG :]))),
    ]


def _textures(strips: Floats32) -> list[RealArray]:
    """Change along the line, on it and far beside it, and the greatest edge or ridge beside it."""
    grey = strips[:, LINE] @ LUMA
    change = np.abs(np.diff(grey, axis=1))
    bend = np.abs(np.diff(grey.mean(axis=1), 2, axis=1)) / 10
    return [
        change[..., ON_LINE].mean(axis=(1, 2))[:, None] / 10,
        _in_order(change[..., :8].mean(axis=(1, 2)) / 10, change[..., -8:].mean(axis=(1, 2)) / 10),
        _in_order(bend[:, : MIDDLE - 4].max(axis=1), bend[:, MIDDLE + 4 :].max(axis=1)),
    ]


def _in_order(one: RealArray, other: RealArray) -> RealArray:
    """(..., 2) the lesser and the greater of two values, since a line has no first side or end."""
    return np.stack([np.minimum(one, other), np.maximum(one, other)], axis=-1)


def log_odds(scores: RealArray, least: float) -> RealArray:
    """Return the logarithms of the odds of scores, which are kept `least` from 0 and 1."""
    kept = np.clip(scores, least, 1 - least)
    out: RealArray = np.log(kept / (1 - kept))
    return out


def _shapes(proposals: Proposals) -> RealArray:
    """(C, 20) odds, length, shape and place of the proposals, and what is near them."""
    height, width = proposals.image_size
    ends = np.array([[line[0], line[-1]] for line in proposals.polylines])
    margins = np.minimum(ends, np.array([width, height]) - ends).min(axis=-1)
    chords = ends[:, 1] - ends[:, 0]
    chord_px = np.maximum(np.hypot(chords[:, 0], chords[:, 1]), 1e-6)
    bends = [
        np.abs((line[:, 0] - line[0, 0]) * y - (line[:, 1] - line[0, 1]) * x).max() / length
        for line, (x, y), length in zip(proposals.polylines, chords, chord_px, strict=True)
    ]
    bend_px = np.array(bends)
    extent, enlargement = np.maximum(proposals.extent_px, 1), proposals.enlargement
    short_px = min(height, width)
    values = [
        log_odds(proposals.prior, 0.02),
        log_odds(proposals.mean_score, 0.02),
        np.minimum(proposals.support, 4),
        np.log(extent),
        np.log(extent / enlargement),
        np.log(extent / short_px),
        proposals.spread_px,
        *log_odds(proposals.quantiles, 0.02).T,
        np.minimum(margins.min(axis=1), 64) / 64,
        np.minimum(margins.max(axis=1), 64) / 64,
        np.log1p(bend_px),
        bend_px / np.maximum(chord_px, 1),
        *np.log1p(count_neighbours(proposals)).T,
        np.full(len(extent), np.log(enlargement)),
        np.full(len(extent), np.log(short_px / enlargement)),
    ]
    return np.stack(values, axis=1)
