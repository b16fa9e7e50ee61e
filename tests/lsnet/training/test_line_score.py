"""Training of the line score on made-up examples, and the truth of proposals."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
import torch
from nets import TINY, tiny_net

from lsnet.lines.features import FEATURES
from lsnet.lines.overlap import find_overlaps
from lsnet.lines.polylines import Polylines
from lsnet.lines.score import read_line_score
from lsnet.synth.backgrounds import BackgroundPool
from lsnet.training import line_score
from lsnet.training.line_scenes import Examples, SceneKind, draw_scene
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


def test_a_score_learns_and_is_the_same_in_a_weights_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(line_score, "BATCH", 50)
    rng = np.random.default_rng(0)
    features = rng.normal(size=(1500, FEATURES)).astype(np.float32)
    targets = (features[:, 7] > 0).astype(float)
    examples = Examples(features, targets, np.full(1500, 100.0), np.ones(1500, np.int64))
    nets = [line_score.fit(examples, seed) for seed in range(len(line_score.MEMBERS))]
    path = tmp_path / "w.safetensors"
    save_weights(path, tiny_net(), WeightsCard("a", "fast", TINY, 0.5), line_score.as_line_score(nets))
    loaded = read_line_score(read_weights(path))
    assert loaded is not None
    logits = loaded.logits(features)
    assert ((logits > 0) == targets).mean() > 0.9
    with torch.no_grad():
        expected = np.stack([net(torch.from_numpy(features)).numpy() for net in nets])
    np.testing.assert_allclose(logits, expected, atol=1e-4)


def test_scenes_are_drawn_by_seed_and_of_every_kind() -> None:
    pool = BackgroundPool([])
    kinds = [draw_scene(pool, np.random.default_rng([1, i]))[2] for i in range(2)]
    assert kinds == [draw_scene(pool, np.random.default_rng([1, i]))[2] for i in range(2)]
    assert set(kinds) <= set(SceneKind)
