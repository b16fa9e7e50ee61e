"""What other proposals say about one: against the definitions, line by line, and in the score."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lsnet.lines.context import CONTEXT, LineContext, LineLayout, context_inputs, context_of, has_context
from lsnet.lines.perceptrons import Perceptrons

SIZE = (600, 800)


def random_layout(count: int, seed: int) -> tuple[LineLayout, np.ndarray]:
    rng = np.random.default_rng(seed)
    starts = rng.uniform(0, 500, (count, 2))
    angles = rng.choice([0.2, 0.25, 0.3, 1.5], count) + rng.normal(0, 0.02, count)
    lengths = rng.uniform(40, 400, count)
    ends = starts + np.stack([np.cos(angles), np.sin(angles)], axis=1) * lengths[:, None]
    priors = rng.choice([0.01, 0.2, 0.8], count)
    return LineLayout(np.concatenate([starts, ends], axis=1), lengths, priors, SIZE), rng.normal(0, 4, count)


def by_definition(layout: LineLayout, logits: np.ndarray, i: int) -> list[float]:
    """Features of line i, from one other line after the other."""
    own = np.clip(logits, -6, 6)
    sure = 1 / (1 + np.exp(-own))
    px, short = layout.lengths_px, min(layout.image_size)
    others = [j for j in range(len(px)) if j != i and layout.priors[j] >= 0.03]
    vector = lambda j: layout.ends[j, 2:] - layout.ends[j, :2]  # noqa: E731
    middle = lambda j: (layout.ends[j, 2:] + layout.ends[j, :2]) / 2  # noqa: E731
    unit = vector(i) / np.linalg.norm(vector(i))
    parallel, beside = [], []
    for j in others:
        cosine = abs(vector(j) @ unit) / np.linalg.norm(vector(j))
        if np.degrees(np.arccos(min(cosine, 1))) >= 10:
            continue
        parallel.append(j)
        along = abs((middle(j) - middle(i)) @ unit)
        aside = abs(np.linalg.det(np.stack([middle(j) - middle(i), unit])))
        reach = [np.linalg.norm(vector(k)) for k in (i, j)]
        if sum(reach) / 2 - along > 0.3 * min(reach) and aside > 3:
            beside.append((j, aside / short))

    def mean(group: list[int]) -> float:
        return sum(px[j] * own[j] for j in group) / sum(px[j] for j in group) if group else -6.0

    highest = [*sorted((own[j] for j in others), reverse=True), -6, -6, -6]
    likely = sum(px[j] * sure[j] for j in others)
    found = [highest[0], highest[1], sum(highest[:3]) / 3, mean(others)]
    found += [likely / max(sum(px[j] for j in others), 1), np.log1p(4 * likely / short)]
    for near, far in ((0, 0.04), (0.04, 0.15), (0.15, 0.6)):
        group = [j for j, distance in beside if near <= distance < far]
        found += [np.log1p(len(group)), max([own[j] for j in group], default=-6), mean(group)]
    found.append(
        np.log1p(sum(sure[j] * min(px[j], px[i]) / px[i] for j, distance in beside if distance < 0.25))
    )
    along_px = sum(px[j] * sure[j] for j in parallel)
    found += [along_px / max(likely, 1), np.log1p(along_px / short)]
    count = len(others) + 1
    return [*found, np.log(count), np.log(count / 0.48), np.log(px[i] / short)]


@pytest.mark.parametrize(("count", "seed"), [(1, 0), (2, 1), (4, 2), (30, 3), (30, 4)])
def test_features_are_those_of_the_definition(count: int, seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lsnet.lines.context.CHUNK", 8)
    layout, logits = random_layout(count, seed)
    found = context_of(layout, logits)
    assert found.shape == (count, CONTEXT)
    np.testing.assert_allclose(found, [by_definition(layout, logits, i) for i in range(count)], atol=1e-9)


def test_features_do_not_depend_on_the_direction_of_lines_or_the_side() -> None:
    layout, logits = random_layout(20, 5)
    mirrored = layout.ends[:, [2, 3, 0, 1]] * [-1, 1, -1, 1] + [SIZE[1], 0, SIZE[1], 0]
    other = context_of(replace(layout, ends=mirrored), logits)
    np.testing.assert_allclose(other, context_of(layout, logits), atol=1e-9)


def test_evidence_is_limited_and_counts_with_its_factor() -> None:
    layout, logits = random_layout(6, 6)
    inputs = context_inputs(layout, np.zeros((3, 6), np.float32), logits)
    assert inputs.shape == (6, 5 + CONTEXT)
    for bias, evidence in ((0.5, 0.5), (9.0, 2.0), (-9.0, -2.0)):
        flat = Perceptrons(
            np.zeros((1, 1, 5 + CONTEXT), np.float32),
            np.ones((1, 1, 5 + CONTEXT), np.float32),
            (np.zeros((1, 5 + CONTEXT, 1), np.float32),),
            (np.full((1, 1, 1), bias, np.float32),),
        )
        added = LineContext(flat, np.array([0.6, 0.1], np.float32)).added(inputs)
        np.testing.assert_allclose(added, np.full(6, 0.6 * evidence + 0.1), rtol=1e-6)


def test_images_that_the_detector_enlarges_have_no_context() -> None:
    assert has_context((360, 540), 1.0)
    assert has_context((1296, 1728), 1.5)
    assert not has_context((384, 384), 3.0)
    assert not has_context((192, 300), 1.0)
