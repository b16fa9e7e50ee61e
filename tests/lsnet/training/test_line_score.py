"""Training of the line score on made-up examples, and the truth of proposals."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest
import torch
from nets import TINY, openvino_or_skip, tiny_net

from lsnet.errors import LSNetError
from lsnet.lines.context import LineLayout
from lsnet.lines.features import FEATURES
from lsnet.lines.overlap import find_overlaps
from lsnet.lines.perceptrons import Perceptrons
from lsnet.lines.polylines import Polylines
from lsnet.lines.score import LineScore, read_line_score
from lsnet.synth.backgrounds import BackgroundPool
from lsnet.synth.pbr import scenes as pbr_scenes
from lsnet.synth.pbr.scenes import laid_over, rendered_pictures
from lsnet.training import line_networks, line_scenes
from lsnet.training.line_scenes import Examples, LineScenes, SceneKind
from lsnet.training.line_sources import LineSource, collect
from lsnet.training.line_validation import validate
from lsnet.weights import save_weights
from lsnet.weights_file import WeightsCard, read_weights

if TYPE_CHECKING:
    from pathlib import Path

WIRE = np.array([[0.0, 50], [200, 50]])


def test_the_share_of_a_line_on_a_wire_counts_place_and_direction() -> None:
    lines = [
        np.array([[20.0, 51], [120, 51]]),  # on it
        np.array([[100.0, 50], [300, 50]]),  # half of it
        np.array([[20.0, 60], [120, 60]]),  # beside it
        np.array([[100.0, 45], [102, 55]]),  # across it
    ]
    found = Polylines.of(lines)
    assert find_overlaps(found, Polylines.of([WIRE]), reach_px=3.0).shares() == pytest.approx(
        [1, 0.5, 0, 0], abs=0.03
    )
    assert find_overlaps(found, Polylines.of([]), reach_px=3.0).shares().tolist() == [0, 0, 0, 0]


def made_up(features: np.ndarray, targets: np.ndarray, scenes: np.ndarray) -> Examples:
    """Return examples without places, of towers."""
    count = len(targets)
    ones = np.ones(count)
    return Examples(
        features,
        ones / 2,
        targets,
        100 * ones,
        np.full(count, SceneKind.TOWER),
        scenes,
        np.zeros((count, 4)),
        np.full((count, 2), 500),
        ones,
    )


def test_a_score_learns_and_is_the_same_in_a_weights_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(line_networks, "BATCH", 50)
    rng = np.random.default_rng(0)
    features = rng.normal(size=(1500, FEATURES)).astype(np.float32)
    targets = (features[:, 7] > 0).astype(float)
    lengths_px = np.full(1500, 100.0)
    nets = [line_networks.fit(features, targets, lengths_px, seed) for seed in (0, 1)]
    path = tmp_path / "w.safetensors"
    score = LineScore(line_networks.as_perceptrons(nets), np.array([0.5, 0.5, 0, 0], np.float32))
    save_weights(path, tiny_net(), WeightsCard("a", "fast", TINY, 0.5), score)
    loaded = read_line_score(read_weights(path))
    assert loaded is not None
    logits = loaded.networks.logits(features)
    assert ((logits > 0) == targets).mean() > 0.9
    with torch.no_grad():
        expected = np.stack([net(torch.from_numpy(features)).numpy() for net in nets])
    np.testing.assert_allclose(logits, expected, atol=1e-4)


def test_the_difference_of_networks_is_one_network() -> None:
    """Of two that see five inputs and two that see the first three."""
    rng = np.random.default_rng(0)
    inputs = rng.normal(size=(300, 5)).astype(np.float32)
    targets = (inputs[:, 4] > 0).astype(float)
    recipe = line_networks.NetworkRecipe((6,), 2)
    seeing, blind = (
        [line_networks.fit(seen, targets, np.full(300, 100.0), seed, recipe) for seed in (0, 1)]
        for seen in (inputs, inputs[:, :3].copy())
    )
    with torch.no_grad():
        means = [
            np.mean([net(torch.from_numpy(seen)).numpy() for net in nets], axis=0)
            for nets, seen in ((seeing, inputs), (blind, inputs[:, :3].copy()))
        ]
    found = line_networks.as_difference(seeing, blind)
    assert len(found) == 1
    np.testing.assert_allclose(found.logits(inputs)[0], means[0] - means[1], atol=1e-5)


def test_a_context_learns_that_wires_come_together(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first score knows some wires; the others are only known by the company of those."""
    monkeypatch.setattr(line_networks, "BATCH", 50)
    rng = np.random.default_rng(1)
    scenes = np.repeat(np.arange(200), 6)
    has_wires = rng.random(200) < 0.5
    targets = has_wires[scenes].astype(float)
    features = np.zeros((1200, FEATURES), np.float32)
    features[:, 0] = np.where((targets > 0) & (rng.random(1200) < 0.4), 2, -1)
    weights = np.zeros((1, FEATURES, 1), np.float32)
    weights[0, 0, 0] = 1
    flat = np.zeros((1, 1, FEATURES), np.float32)
    networks = Perceptrons(flat, flat + 1, (weights,), (np.zeros((1, 1, 1), np.float32),))
    score = LineScore(networks, np.array([1, 0, 0], np.float32))
    examples = made_up(features, targets, scenes)
    context = line_networks.fit_context(score, examples, 0)
    unknown = (features[:, 0] < 0) & (np.bincount(scenes, features[:, 0] > 0)[scenes] >= 2)
    found = line_networks.scores_of(replace(score, context=context), examples)
    before = line_networks.scores_of(score, examples)
    assert (found[unknown] > before[unknown] + 0.1).all()
    assert (found[targets == 0] < found[unknown].min()).all()


def test_scenes_are_the_same_for_the_same_seed_and_of_every_kind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(line_scenes, "SIZES_PX", (128,) * 5)
    pixels = np.zeros((64, 64, 4), np.uint8)
    pixels[30:33] = (0, 0, 255, 255)
    cv2.imwrite(str(tmp_path / "000000.png"), pixels)
    truth = {"size": [64, 64], "seed": 0, "lines": [[[-9, 31.5], [70, 31.5]]]}
    (tmp_path / "000000.json").write_text(json.dumps(truth))
    scenes = LineScenes(BackgroundPool([]), rendered_pictures(tmp_path), seed=1)
    for index in (0, 5):
        (one, *kind), (two, *same) = scenes[index], scenes[index]
        np.testing.assert_array_equal(one.image, two.image)
        assert kind == same
    drawn = [scenes[i] for i in range(60)]
    assert {kind for _, kind, _ in drawn} == set(SceneKind)
    assert not any(scene.lines for scene, kind, _ in drawn if kind == SceneKind.EMPTY)
    without = LineScenes(BackgroundPool([]), (), seed=1)
    assert {without[i][1] for i in range(60)} == set(SceneKind) - {SceneKind.RENDERED}


def test_a_folder_that_cannot_be_used_is_one_error_with_workers(tmp_path: Path) -> None:
    source = LineSource("fast", (), tmp_path, "training", 0)
    with pytest.raises(LSNetError, match="no rendered pictures in this folder"):
        collect(source, 2, 2, lambda: None)


def test_workers_give_the_same_examples_in_the_same_order() -> None:
    openvino_or_skip()
    source = LineSource("fast", (), None, "all", seed=3)
    seen: list[int] = []
    one, two = (collect(source, 12, workers, lambda: seen.append(1)) for workers in (1, 2))
    assert len(seen) == 24
    assert one is not None
    assert two is not None
    np.testing.assert_array_equal(one.scenes, two.scenes)
    np.testing.assert_array_equal(one.kinds, two.kinds)
    np.testing.assert_allclose(one.features, two.features, atol=1e-3)


def test_wires_of_a_rendered_scene_lie_where_its_lines_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A red cable over a grey ground, without augmentation, moved and cropped in any way."""
    pixels = np.zeros((128, 128, 4), np.uint8)
    pixels[60:64] = (0, 0, 255, 255)
    cv2.imwrite(str(tmp_path / "000000.png"), pixels)
    truth = {"size": [128, 128], "seed": 0, "lines": [[[-200, 62], [300, 62]]]}
    (tmp_path / "000000.json").write_text(json.dumps(truth))
    monkeypatch.setattr(pbr_scenes, "augment_further", lambda image, lines, _rng: (image, lines))
    ground = np.full((96, 96, 3), 120, np.uint8)
    seen = 0
    for index in range(40):
        rng = np.random.default_rng(index)
        scene = laid_over(rendered_pictures(tmp_path), index, ground, 0, rng)
        is_red = scene.image[..., 0].astype(int) - scene.image[..., 1] > 120
        rows, columns = np.nonzero(is_red)
        if len(rows) < 20:
            continue  # the crop has none of it
        seen += 1
        start, end = scene.lines[0]
        along = (end - start) / np.hypot(*(end - start))
        away = np.stack([columns + 0.5, rows + 0.5], axis=1) - start
        offsets = away[:, 0] * along[1] - away[:, 1] * along[0]
        assert abs(offsets.mean()) < 0.6
        assert abs(offsets).max() < 9  # 4 px, zoomed up to four times
    assert seen > 10


def test_validation_counts_lengths_by_kind_and_scenes_without_wires() -> None:
    """Two clutter proposals of 100 px on a wire, of which one is reported, and 50 px beside one reported."""
    kinds = np.array([SceneKind.CLUTTER] * 3 + [SceneKind.EMPTY] * 3)
    examples = Examples(
        np.zeros((6, FEATURES), np.float32),
        np.full(6, 0.5),
        np.array([1.0, 1, 0, 0, 0, 0]),
        np.array([100.0, 100, 50, 80, 80, 80]),
        kinds,
        np.array([0, 0, 0, 1, 1, 2]),
        np.zeros((6, 4)),
        np.full((6, 2), 500),
        np.ones(6),
    )
    found = validate(examples, np.array([0.9, 0.4, 0.6, 0.7, 0.8, 0.1]), 0.5)
    assert found.f1 == {SceneKind.CLUTTER: pytest.approx(2 * (2 / 3) * 0.5 / (2 / 3 + 0.5))}
    assert found.false_share == 0.5
    assert "50% of scenes without wires" in str(found)


def test_the_scores_are_those_that_rate_proposals() -> None:
    """In two scenes: one large enough for a context, one enlarged."""
    score = read_line_score(read_weights("fast"))
    assert score is not None
    rng = np.random.default_rng(0)
    features = rng.normal(size=(6, FEATURES)).astype(np.float32)
    priors = np.array([0.001, 0.2, 0.5, 0.9, 0.3, 0.6])
    examples = replace(
        made_up(features, np.zeros(6), np.array([0, 0, 0, 0, 1, 1])),
        priors=priors,
        ends=rng.uniform(0, 500, (6, 4)),
        enlargements=np.array([1.0, 1, 1, 1, 3, 3]),
    )
    found = line_networks.scores_of(score, examples)
    learned = score.networks.logits(features)
    first = score.first_logits(learned, priors)
    layout = LineLayout(examples.ends[:4], examples.lengths_px[:4], priors[:4], (500, 500))
    with_context = score.logits(learned[:, :4], priors[:4], layout)
    np.testing.assert_allclose(found[:4], 1 / (1 + np.exp(-with_context)), rtol=1e-5)
    np.testing.assert_allclose(found[4:], 1 / (1 + np.exp(-first[4:])), rtol=1e-5)
