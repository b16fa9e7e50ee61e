"""What is computed of all lines at once is what the plain form gives of one after the other."""

from __future__ import annotations

import cv2
import numpy as np
from scipy.ndimage import map_coordinates
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from lsnet.lines.bridging import _costs, _ends, _partners
from lsnet.lines.components import components
from lsnet.lines.polylines import Polylines
from lsnet.lines.quantiles import group_quantiles, row_quantiles
from lsnet.lines.strips import ACROSS_PX, BEYOND, cut_strips
from lsnet.lines.surroundings import CELL_PX, DIRECTIONS, PLACE_PX, count_neighbours

SIZE = (240, 320)


def polylines(count: int, seed: int = 0) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    starts, steps = rng.uniform(150, 250, (count, 2)), rng.uniform(-25, 25, (count, 2))
    return [
        start + np.arange(4 + k % 3)[:, None] * step + rng.normal(0, 1, (4 + k % 3, 2))
        for k, (start, step) in enumerate(zip(starts, steps, strict=True))
    ]


def along(line: np.ndarray, distances: np.ndarray) -> np.ndarray:
    arc = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    return np.stack([np.interp(distances, arc, line[:, k]) for k in (0, 1)], axis=1)


def length(line: np.ndarray) -> float:
    return float(np.hypot(*np.diff(line, axis=0).T).sum())


def test_places_on_polylines() -> None:
    lines = polylines(7)
    joined = Polylines.of(lines)
    np.testing.assert_allclose(joined.lengths_px, [length(line) for line in lines])
    expected = [along(line, np.linspace(0, length(line), 11)) for line in lines]
    np.testing.assert_allclose(joined.spaced(11, np.array([5, 2])), [expected[5], expected[2]], atol=1e-9)


def test_components_are_those_of_scipy() -> None:
    rng = np.random.default_rng(0)
    for n_pairs in (0, 20, 60, 300):
        pairs = rng.integers(0, 100, (n_pairs, 2))
        graph = coo_array((np.ones(n_pairs), (pairs[:, 0], pairs[:, 1])), shape=(100, 100))
        number = connected_components(graph, directed=False)[1]
        first = np.unique(number, return_index=True)[1]
        np.testing.assert_array_equal(components(100, pairs), first[number])


def test_quantiles() -> None:
    rng, shares = np.random.default_rng(0), (0.0, 0.1, 0.5, 0.93, 1.0)
    rows = rng.normal(size=(3, 4, 10))
    np.testing.assert_allclose(row_quantiles(rows, shares), np.moveaxis(np.quantile(rows, shares, -1), 0, -1))
    groups = [rng.normal(size=n) for n in (1, 2, 9, 4)]
    first = np.cumsum([0] + [len(group) for group in groups])
    expected = [np.quantile(group, shares) for group in groups]
    np.testing.assert_allclose(group_quantiles(np.concatenate(groups), first, shares), expected, atol=1e-12)
    assert group_quantiles(np.zeros(0), np.zeros(1, np.intp), shares).shape == (0, len(shares))


def test_strips_show_the_image_along_the_normals() -> None:
    image = cv2.GaussianBlur(np.random.default_rng(0).uniform(0, 255, (*SIZE, 3)), (0, 0), 3).astype(np.uint8)
    line = np.array([[60.0, 80.0], [250.0, 160.0]])
    strips, places = cut_strips(image, Polylines.of([line]), np.array([0]))
    normal = np.array([-80.0, 190.0]) / np.hypot(80, 190)
    at = places[:, 0].T[:, None] + ACROSS_PX[:, None] * normal  # (T, O, 2)
    for channel in range(3):
        expected = map_coordinates(image[..., channel].astype(float), at.T[::-1] - 0.5, order=1)
        assert np.abs(strips[channel, 0] - expected)[:, BEYOND:-BEYOND].max() < 3
    np.testing.assert_allclose(strips[3], np.tensordot([0.299, 0.587, 0.114], strips[:3], 1), atol=1e-3)


def test_neighbours_are_counted_as_piece_by_piece() -> None:
    """Each piece counts those of other lines in the cells around its own."""
    lines = polylines(12)
    pieces = []
    for number, line in enumerate(lines):
        count = max(4, int(length(line) / PLACE_PX))
        points = along(line, np.linspace(0, length(line), count + 1))
        steps = np.diff(points, axis=0)
        turns = np.round(np.arctan2(steps[:, 1], steps[:, 0]) / np.pi * DIRECTIONS) % DIRECTIONS
        cells = (points[1:] + points[:-1]) / 2 // CELL_PX
        pieces += [
            (number, cell, turn, length(line) / count) for cell, turn in zip(cells, turns, strict=True)
        ]
    expected = np.zeros((len(lines), 4))
    for number in range(len(lines)):
        parallel, across = [], []
        for _, cell, turn, _ in (piece for piece in pieces if piece[0] == number):
            near = [p for p in pieces if p[0] != number and np.abs(p[1] - cell).max() <= 1]
            alike = [(p[2] - turn) % DIRECTIONS in (0, 1, DIRECTIONS - 1) for p in near]
            parallel.append(sum(p[3] for p, is_alike in zip(near, alike, strict=True) if is_alike))
            across.append(sum(p[3] for p, is_alike in zip(near, alike, strict=True) if not is_alike))
        expected[number] = np.mean(parallel), np.mean(across), np.median(across), np.median(parallel)
    found = count_neighbours(Polylines.of(lines), (400, 400))
    np.testing.assert_allclose(found, expected / (3 * CELL_PX), atol=1e-4)


def test_best_partners_are_those_of_all_pairs() -> None:
    rng = np.random.default_rng(0)
    starts, angles = rng.uniform(0, 900, (60, 2)), np.radians(rng.uniform(-3, 3, 60))
    steps = 60 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    lines = [np.stack([start, start + step]) for start, step in zip(starts, steps, strict=True)]
    lines += [line + step * rng.uniform(1.2, 1.9) for line, step in zip(lines, steps, strict=True)]
    places, outwards = _ends(Polylines.of(lines))
    one, other = np.divmod(np.arange(len(places) ** 2), len(places))
    pairs = np.stack([one, other], axis=1)
    cost = _costs(places[pairs], outwards[pairs], 60.0).reshape(len(places), -1)
    cost[(one // 2 == other // 2).reshape(cost.shape)] = np.inf
    best = cost.argmin(axis=1)
    mutual = [k for k in range(len(places)) if best[best[k]] == k and np.isfinite(cost[k, best[k]])]
    assert len(mutual) > 40
    found = _partners(places, outwards, 60.0)
    np.testing.assert_array_equal(found, [mutual, best[mutual]])
