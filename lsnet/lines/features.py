"""Features of proposals that the learned line score rates.

A wire has the same ground on both sides, keeps its own tone while the ground changes, and is a ridge along
its whole length. A kerb has a different ground on each side, a joint follows the tone of its ground, and
other steel crosses steel.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from lsnet.geometry import cross
from lsnet.lines.quantiles import row_quantiles
from lsnet.lines.strips import ACROSS_PX, ALONG, BEYOND, cut_strips, is_inside
from lsnet.lines.surroundings import count_neighbours

if TYPE_CHECKING:
    from lsnet.arrays import Floats32, ImageArray, Indices, Mask, RealArray
    from lsnet.lines.proposals import Proposals

FEATURES = 180
MIDDLE = len(ACROSS_PX) // 2
LINE = slice(BEYOND, BEYOND + ALONG)
ON_LINE = slice(MIDDLE - 1, MIDDLE + 2)
SIDES_PX = ((2, 3), (4, 6), (6, 9), (9, 14), (14, 24), (24, 40))  # distances of the ground that is compared
DETAILED = [1, 3]  # of these distances
SIDES = tuple(  # of one side, then of the other, by distance: which of the offsets across the line
    slice(inside[0], inside[-1] + 1)
    for side in (-ACROSS_PX, ACROSS_PX)
    for inside in (np.flatnonzero((side >= near) & (side <= far)) for near, far in SIDES_PX)
)
SIDE_SHARES = np.array([1 / (side.stop - side.start) for side in SIDES], np.float32)
GREY = 3  # the channel after red, green and blue
CELL_STEP_PX = 16
CHUNK = 32  # lines that are looked at together, so that their pixels stay in the cache


def features_of(
    image: ImageArray, cell_scores: Floats32, proposals: Proposals, chosen: Indices | None = None
) -> Floats32:
    """Return (C, FEATURES) features of C chosen proposals.

    Args:
        image: The network's input, (H, W, 3), without padding.
        cell_scores: (R, K) scores of the cells of the interleaved grids.
        proposals: Lines in the pixels of the image.
        chosen: Which of them; all by default.
    """
    chosen = np.arange(len(proposals)) if chosen is None else chosen
    cuts = np.arange(CHUNK, len(chosen), CHUNK)
    looks = [_look(image, cell_scores, proposals, each) for each in np.split(chosen, cuts)]
    return np.concatenate([np.concatenate(looks), _shapes(proposals)[chosen]], axis=1, dtype=np.float32)


def _look(image: ImageArray, cell_scores: Floats32, proposals: Proposals, chosen: Indices) -> Floats32:
    """(C, F) features of what lies on and around chosen proposals."""
    strips, places = cut_strips(image, proposals.polylines, chosen)
    tone = strips[:, :, ON_LINE].mean(axis=2)
    ground = np.stack([np.add.reduce(strips[:, :, side], axis=2) for side in SIDES])
    ground *= SIDE_SHARES[:, None, None, None]
    grey = strips[GREY, ..., LINE]
    parts = [
        *_profiles(grey, _mean(strips[:GREY, ..., LINE])),
        *_ridges(tone, ground.reshape(2, len(SIDES_PX), *tone.shape)),
        *_ends(is_inside(places, proposals.image_size), _scores_along(cell_scores, places)),
        *_textures(grey),
    ]
    return np.concatenate(parts, axis=1, dtype=np.float32)


def _scores_along(scores: Floats32, places: Floats32) -> Floats32:
    """(C, T) second highest of the scores of the four cells around each place (2, C, T)."""
    rows, columns = scores.shape
    x = np.clip(places[0] / CELL_STEP_PX - 1, 0, columns - 1)
    y = np.clip(places[1] / CELL_STEP_PX - 1, 0, rows - 1)
    left, top = np.floor(x).astype(np.intp), np.floor(y).astype(np.intp)
    right, bottom = np.minimum(left + 1, columns - 1), np.minimum(top + 1, rows - 1)
    above = scores[top, left], scores[top, right]
    below = scores[bottom, left], scores[bottom, right]
    high, other = np.maximum(*above), np.maximum(*below)
    # The second of four is the lesser of the two pairs' highest, or the highest of their lowest.
    out: Floats32 = np.maximum(np.minimum(high, other), np.maximum(np.minimum(*above), np.minimum(*below)))
    return out


def _mirrored(values: RealArray) -> tuple[RealArray, RealArray]:
    """The values (..., O) on one side and on the other, both from the line outwards."""
    return values[..., MIDDLE + 1 :], values[..., :MIDDLE][..., ::-1]


def _profiles(grey: Floats32, colours: Floats32) -> list[RealArray]:
    """Mean profile across the line: symmetric and antisymmetric part, colour, spread along the line.

    From tones (C, O, T), and (3, C, O) the mean colours along the line.
    """
    profile, spread = _mean_and_spread(grey)
    level = profile.mean(axis=1)
    relative = profile - level[:, None]
    contrast = np.sqrt((spread**2 + relative**2).mean(axis=1)) + 4
    relative, spread = relative / contrast[:, None], spread / contrast[:, None]
    one, other = _mirrored(relative)
    colour, other_colour = _mirrored(colours)
    offsets = np.array([0, 1, 2, 3, 5, 7, 9, 12])
    return [
        np.abs((one + other) / 2 - relative[:, MIDDLE : MIDDLE + 1]),
        np.abs(one - other),
        np.abs(colour - other_colour).max(axis=0) / 30,
        (spread[:, MIDDLE + offsets] + spread[:, MIDDLE - offsets]) / 2,
        np.stack([np.log(contrast), level / 255], axis=1),
    ]


def _mean(values: RealArray | Mask) -> Floats32:
    """Mean along the line of values (..., T). `values.mean(axis=-1)` takes longer for few values."""
    out: Floats32 = np.add.reduce(values, axis=-1, dtype=np.float32) * np.float32(1 / values.shape[-1])
    return out


def _mean_and_spread(values: RealArray) -> tuple[RealArray, RealArray]:
    """Mean and standard deviation along the line of values (..., T)."""
    mean = _mean(values)
    return mean, np.sqrt(_mean(np.square(values - mean[..., None])))


def _ridges(tone: Floats32, ground: Floats32) -> list[RealArray]:
    """How far the line stands out from the ground at D distances, on both sides at once.

    From the four channels of the line (4, C, T), and of the ground on both sides (2, D, 4, C, T).
    """
    n_distances = len(SIDES_PX)
    grey, greys = tone[GREY], ground[:, :, GREY]
    line, near, colour = grey[:, LINE], greys[..., LINE], tone[:GREY, :, LINE]
    middle = near.mean(axis=0)
    contrast, contrast_spread = _mean_and_spread(line - middle)
    sign = np.where(contrast < 0, np.float32(-1), np.float32(1))[..., None]
    height = np.minimum(*(sign * (grey - greys)))
    ridges = _ridge(near, contrast, contrast_spread, height[..., LINE])
    colours = _ridge_colours(colour, ground[:, :, :GREY, :, LINE], _mean_and_spread(near)[1])
    details = _ridge_details(line, middle[DETAILED], height[DETAILED])
    parts: list[RealArray] = []
    for k in range(n_distances):
        parts += [ridges[k], colours[k]]
        parts += [details[DETAILED.index(k)]] if k in DETAILED else []
    spreads = [_mean_and_spread(line)[1], _mean_and_spread(colour)[1].max(axis=0)]
    return [*parts, np.stack(spreads, axis=1) / 20]


def _ridge(ground: RealArray, contrast: RealArray, spread: RealArray, height: RealArray) -> RealArray:
    """(D, C, 8) from tones of both grounds (2, D, C, T), mean and spread (D, C) of the contrast with both.

    `height` (D, C, T) is that of the ridge.
    """
    difference = ground[0] - ground[1]
    values: list[RealArray] = [
        _mean(np.abs(difference)) / 20,
        np.abs(_mean(difference)) / 20,
        np.abs(contrast) / 20,
        np.abs(contrast) / (spread + 2),
        _mean(height > 2),
        _mean(height > 8),
        row_quantiles(height, [0.2])[..., 0] / 20,
        _mean(height) / 20,
    ]
    return np.stack(values, axis=-1)


def _ridge_colours(colour: RealArray, ground: RealArray, spreads: RealArray) -> RealArray:
    """(D, C, 5) from colours of the line (3, C, T), of both grounds (2, D, 3, C, T), spreads (2, D, C)."""
    means = _mean(ground)
    apart = np.minimum(*np.abs(colour - ground)).max(axis=1)
    values = [
        np.abs(means[0] - means[1]).max(axis=1) / 20,
        np.abs(_mean(colour) - means.mean(axis=0)).max(axis=1) / 20,
        _mean(apart) / 20,
        spreads.sum(axis=0) / 20,
        spreads.min(axis=0) / 20,
    ]
    return np.stack(values, axis=-1)


def _ridge_details(tone: RealArray, ground: RealArray, height: RealArray) -> RealArray:
    """(D, C, 7): whether the line follows the ground's tone, its ridge by quarters and beyond the ends."""
    own = tone - _mean(tone)[..., None]
    below = ground - _mean(ground)[..., None]
    power = _mean(np.square(own)) * _mean(np.square(below)) + 4
    quarters = _mean((height[..., LINE] > 3).reshape(*height.shape[:2], 4, -1))
    beyond = [_mean(height[..., :BEYOND]) / 20, _mean(height[..., BEYOND + ALONG :]) / 20]
    follows = _mean(own * below) / np.sqrt(power)
    return np.concatenate([follows[..., None], np.sort(quarters, axis=-1), _in_order(*beyond)], axis=-1)


def _ends(inside: Mask, cells: Floats32) -> list[RealArray]:
    """How much of the image lies beyond the ends, and what the network says along the line and there."""
    line = cells[:, LINE]
    return [
        _in_order(*(part.mean(axis=1) for part in (inside[:, :BEYOND], inside[:, BEYOND + ALONG :]))),
        np.concatenate([_mean(line)[:, None], row_quantiles(line, [0.1, 0.25, 0.5, 0.75])], axis=1),
        _in_order(*(part.max(axis=1) for part in (cells[:, :BEYOND], cells[:, BEYOND + ALONG :]))),
    ]


def _textures(grey: Floats32) -> list[RealArray]:
    """Change along the line, on it and far beside it, and the greatest edge or ridge beside it.

    From tones (C, O, T).
    """
    change = _mean(np.abs(grey[..., 1:] - grey[..., :-1])) / 10
    bend = np.abs(np.diff(_mean(grey), 2, axis=1)) / 10
    return [
        change[:, ON_LINE].mean(axis=1)[:, None],
        _in_order(change[:, :8].mean(axis=1), change[:, -8:].mean(axis=1)),
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
    lines = proposals.polylines
    start, end = lines.points[lines.first[:-1]], lines.points[lines.first[1:] - 1]
    ends = np.stack([start, end], axis=1)
    margins = np.minimum(ends, np.array([width, height]) - ends).min(axis=-1)
    chords = end - start
    chord_px = np.maximum(np.hypot(chords[:, 0], chords[:, 1]), 1e-6)
    number = np.repeat(np.arange(len(chords)), np.diff(lines.first))
    aside = np.abs(cross(lines.points - start[number], chords[number]))
    bend_px = np.maximum.reduceat(aside, lines.first[:-1]) / chord_px
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
        *np.log1p(count_neighbours(lines, proposals.image_size)).T,
        np.full(len(extent), np.log(enlargement)),
        np.full(len(extent), np.log(short_px / enlargement)),
    ]
    return np.stack(values, axis=1)
