"""Chaining the cells of known lines gives these lines."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lsnet.grid import POSITIVE, GridCoder
from lsnet.lines.chaining import ChainingConfig, chain_segments
from lsnet.segments import Lines, Segments

SIZE = (256, 384)


def merge(segments: Segments, config: ChainingConfig | None = None, enlarged: float = 1.0) -> Lines:
    return chain_segments(segments, config or ChainingConfig(), enlarged).lines


def cells_of(*polylines: list[tuple[float, float]], score: float = 0.9) -> Segments:
    """Return the output of a perfect network for these lines."""
    coder = GridCoder()
    targets = coder.encode([np.array(points, float) for points in polylines], SIZE)
    scores = np.where(targets.labels == POSITIVE, np.float32(score), np.float32(0))
    return coder.decode(scores, targets.endpoints, SIZE, min_score=0.5)


def farthest(points: np.ndarray, start: tuple[float, float], end: tuple[float, float]) -> float:
    """Greatest distance of the points from the infinite line through start and end."""
    a, b = np.array(start), np.array(end)
    along = (b - a) / np.hypot(*(b - a))
    return float(np.abs((points - a) @ np.array([-along[1], along[0]])).max())


def span(lines: Lines, k: int) -> float:
    return float(np.hypot(*(lines.points[k][-1] - lines.points[k][0])))


@settings(max_examples=25, deadline=None)
@given(y1=st.floats(20, 230), y2=st.floats(20, 230))
def test_a_straight_line_is_one_line_from_end_to_end(y1: float, y2: float) -> None:
    lines = merge(cells_of([(0, y1), (384, y2)]))
    assert len(lines) == 1
    assert farthest(lines.points[0], (0, y1), (384, y2)) < 0.5
    assert span(lines, 0) > 0.97 * np.hypot(384, y2 - y1)


def test_a_curve_is_one_line_that_follows_it() -> None:
    x = np.linspace(0, 384, 60)
    y = 120 + 40 * ((x - 192) / 192) ** 2
    lines = merge(cells_of(list(zip(x.tolist(), y.tolist(), strict=True))))
    assert len(lines) == 1
    reached = lines.points[0]
    assert np.abs(120 + 40 * ((reached[:, 0] - 192) / 192) ** 2 - reached[:, 1]).max() < 1.5


@pytest.mark.parametrize("distance_px", [12, 20, 40])
def test_parallel_lines_stay_apart(distance_px: int) -> None:
    first, second = [(0.0, 100.0), (384.0, 130.0)], [(0.0, 100.0 + distance_px), (384.0, 130.0 + distance_px)]
    lines = merge(cells_of(first, second))
    assert len(lines) == 2
    nearest = sorted(
        min(farthest(p, first[0], first[1]), farthest(p, second[0], second[1])) for p in lines.points
    )
    assert nearest[-1] < 1.0


def test_crossing_lines_keep_their_directions() -> None:
    down, up = [(0.0, 40.0), (384.0, 220.0)], [(0.0, 220.0), (384.0, 40.0)]
    lines = merge(cells_of(down, up))
    assert len(lines) >= 2
    for points in lines.points:
        assert min(farthest(points, down[0], down[1]), farthest(points, up[0], up[1])) < 2.0


def test_wide_gap_splits_a_line_and_narrow_gap_does_not() -> None:
    left, right = cells_of([(0, 128), (150, 128)]), cells_of([(260, 128), (384, 128)])
    both = Segments(
        np.concatenate([left.endpoints, right.endpoints]), np.concatenate([left.scores, right.scores]), SIZE
    )
    assert len(merge(both)) == 2
    assert len(merge(both, ChainingConfig(max_gap_px=140))) == 1


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_the_order_of_segments_and_of_their_ends_does_not_matter(seed: int) -> None:
    segments = cells_of([(0, 30), (384, 90)], [(10, 250), (300, 120)])
    rng = np.random.default_rng(seed)
    order = rng.permutation(len(segments))
    turned = segments.endpoints[order].copy()
    flip = rng.random(len(order)) < 0.5
    turned[flip] = turned[flip][:, [2, 3, 0, 1]]
    shuffled = merge(Segments(turned, segments.scores[order], SIZE))
    plain = merge(segments)
    assert len(shuffled) == len(plain)
    np.testing.assert_allclose(np.sort(shuffled.scores), np.sort(plain.scores), rtol=1e-4)


def test_longer_lines_of_higher_scores_score_higher() -> None:
    long, short = merge(cells_of([(0, 60), (384, 60)])), merge(cells_of([(0, 60), (80, 60)]))
    unsure = merge(cells_of([(0, 60), (384, 60)], score=0.6))
    assert long.scores[0] > short.scores[0]
    assert long.scores[0] > unsure.scores[0]
    assert 0 < short.scores[0] < 1


def test_short_weak_and_missing_segments_give_no_lines() -> None:
    assert len(merge(Segments.empty(SIZE))) == 0
    assert len(merge(cells_of([(100, 100), (130, 100)]))) == 0
    weak = cells_of([(0, 60), (384, 60)])
    assert len(merge(Segments(weak.endpoints, weak.scores * 0 + 0.1, SIZE))) == 0


def test_lines_scale_with_their_image() -> None:
    lines = merge(cells_of([(0, 60), (384, 60)])).scaled_to((512, 768))
    assert lines.image_size == (512, 768)
    assert farthest(lines.points[0], (0, 120), (768, 120)) < 0.5


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_segments_lie_on_their_lines(seed: int) -> None:
    rng = np.random.default_rng(seed)
    clean = cells_of([(0, 30), (384, 90)], [(10, 250), (300, 120)], [(0, 60), (384, 240)])
    noisy = clean.endpoints + rng.normal(0, 0.4, clean.endpoints.shape).astype(np.float32)
    stray = rng.uniform(0, 250, (30, 4)).astype(np.float32)
    stray[:, 2:] = stray[:, :2] + rng.uniform(-20, 20, (30, 2))
    segments = Segments(
        np.concatenate([noisy, stray]), rng.uniform(0, 1, len(noisy) + 30).astype(np.float32), SIZE
    )
    found = chain_segments(segments, ChainingConfig())
    lines, owners = found.lines, found.line_of
    assert owners.shape == (len(segments),)
    assert set(owners.tolist()) - {-1} == set(range(len(lines)))  # none without a segment
    assert (owners[segments.scores < ChainingConfig().min_segment_score] == -1).all()
    for (x1, y1, x2, y2), owner in zip(segments.endpoints.tolist(), owners.tolist(), strict=True):
        if owner >= 0:
            middle = ((x1 + x2) / 2, (y1 + y2) / 2)
            assert -cv2.pointPolygonTest(contour(lines.points[owner]), middle, measureDist=True) < 6


def contour(points: np.ndarray) -> np.ndarray:
    """There and back along a polyline: OpenCV then measures the distance to it."""
    return np.concatenate([points, points[-2:0:-1]])[:, None].astype(np.float32)


def turned(segments: Segments) -> Segments:
    """The same segments in the image with x and y exchanged."""
    return Segments(segments.endpoints[:, [1, 0, 3, 2]], segments.scores, SIZE[::-1])


@pytest.mark.parametrize("bend", [0, 12])
def test_transposed_segments_give_transposed_lines(bend: float) -> None:
    x = np.linspace(0, 384, 40)
    bent = np.stack([x, 70 + 0.2 * x + bend * np.sin(x / 80)], 1)
    segments = cells_of(list(map(tuple, bent.tolist())), [(10, 250), (300, 120)])
    plain, swapped = merge(segments), merge(turned(segments))
    np.testing.assert_allclose(swapped.scores, plain.scores, rtol=1e-4)
    for ours, theirs in zip(plain.points, swapped.points, strict=True):
        ends = theirs[[0, -1]][:, ::-1]
        ends = ends if np.hypot(*(ends[0] - ours[0])) < np.hypot(*(ends[1] - ours[0])) else ends[::-1]
        np.testing.assert_allclose(ends, ours[[0, -1]], atol=0.1)


def odds(score: float) -> float:
    return score / (1 - score)


def test_line_odds_are_segment_odds_times_length() -> None:
    """At 1.35 times the shorter side, 256 px, the odds are those of the segments."""
    lines = merge(cells_of([(0, 60), (384, 60)]))
    assert odds(lines.scores[0]) == pytest.approx(odds(0.9) * 384 / (1.35 * 256), rel=0.01)
    short = merge(cells_of([(0, 60), (96, 60)]))
    assert odds(short.scores[0]) == pytest.approx(odds(lines.scores[0]) / 4, rel=0.1)


def test_reference_length_shrinks_with_enlargement_down_to_a_bound() -> None:
    segments = cells_of([(0, 60), (384, 60)])
    for enlarged, even_px in ((1.25, 1.35 * 256 / 1.25), (4.0, 240.0)):
        (score,) = merge(segments, enlarged=enlarged).scores
        assert odds(score) == pytest.approx(odds(0.9) * 384 / even_px, rel=0.01)


def test_line_reported_by_every_fourth_cell_has_half_the_odds() -> None:
    segments = cells_of([(0, 90), (384, 90)])
    order = np.argsort(segments.endpoints[:, [0, 2]].mean(axis=1), kind="stable")[::4]
    sparse = Segments(segments.endpoints[order], segments.scores[order], SIZE)
    assert odds(merge(sparse).scores[0]) == pytest.approx(odds(merge(segments).scores[0]) / 2, rel=0.15)


def test_line_score_uses_the_mean_score_of_its_segments() -> None:
    """Two lines at once; weighted by the lengths of the segments."""
    dice = np.random.default_rng(3)
    one, other = cells_of([(0, 60), (384, 60)]), cells_of([(0, 200), (384, 260)])
    drawn = [dice.uniform(0.4, 0.95, len(part)).astype(np.float32) for part in (one, other)]
    both = Segments(np.concatenate([one.endpoints, other.endpoints]), np.concatenate(drawn), SIZE)
    lines = merge(both)
    order = np.argsort([p[:, 1].mean() for p in lines.points])
    for line_score, part, scores in zip(lines.scores[order], (one, other), drawn, strict=True):
        mean = np.average(scores, weights=np.hypot(*(part.endpoints[:, 2:] - part.endpoints[:, :2]).T))
        assert odds(line_score) == pytest.approx(
            odds(mean) * odds(merge(part).scores[0]) / odds(0.9), rel=0.02
        )
