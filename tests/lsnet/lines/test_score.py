"""The learned line score: its features, its tensors in a weights file, and wires against kerbs."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest
from nets import TINY, save_tiny, tiny_net
from safetensors import safe_open
from safetensors.numpy import load_file, save_file

from lsnet import Detector, LSNetError, load_weights
from lsnet.lines.context import CONTEXT, LineContext
from lsnet.lines.features import FEATURES, features_of
from lsnet.lines.perceptrons import Perceptrons
from lsnet.lines.polylines import Polylines
from lsnet.lines.proposals import Proposals
from lsnet.lines.score import LineScore, read_line_score
from lsnet.weights import save_weights
from lsnet.weights_file import WeightsCard, read_weights

if TYPE_CHECKING:
    from pathlib import Path

SIZE = (256, 320)
WIRES = ([[10.0, 40.0], [300.0, 90.0]], [[60.0, 200.0], [200.0, 150.0], [310.0, 130.0]])


def networks(rng: np.random.Generator, *widths: int, count: int) -> Perceptrons:
    draw = lambda *shape: rng.normal(size=shape).astype(np.float32)  # noqa: E731
    return Perceptrons(
        draw(count, 1, widths[0]),
        np.ones((count, 1, widths[0]), np.float32),
        tuple(draw(count, a, b) for a, b in pairwise(widths)),
        tuple(draw(count, 1, b) for b in widths[1:]),
    )


def a_score(seed: int = 0) -> LineScore:
    rng = np.random.default_rng(seed)
    context = networks(rng, CONTEXT + 4, 3, 1, count=1)
    return LineScore(
        networks(rng, FEATURES, 8, 4, 1, count=2),
        np.array([0.1, 0.2, 0.7, 0.0], np.float32),
        LineContext(context, np.array([0.5, 0.1], np.float32)),
    )


def proposals_of(polylines: tuple[list[list[float]], ...]) -> Proposals:
    lines = [np.array(points) for points in polylines]
    extent = np.array([np.hypot(*np.diff(line, axis=0).T).sum() for line in lines])
    ones = np.ones(len(lines))
    return Proposals(
        Polylines.of(lines),
        0.5 * ones,
        0.6 * ones,
        3 * ones,
        extent,
        0.5 * ones,
        0.6 * np.ones((len(lines), 3)),
        SIZE,
        1.0,
    )


def textured(seed: int = 0) -> np.ndarray:
    noise = np.random.default_rng(seed).uniform(60, 160, (*SIZE, 3))
    return cv2.GaussianBlur(noise, (0, 0), 2).astype(np.uint8)


def test_features_do_not_depend_on_the_direction_or_the_side() -> None:
    image = cv2.line(textured(), (10, 40), (300, 90), (240, 240, 240), 2)
    rows, columns = np.mgrid[: SIZE[0] // 16 - 1, : SIZE[1] // 16 - 1]
    cells = (0.3 + 0.02 * rows + 0.01 * columns).astype(np.float32)
    found = features_of(image, cells, proposals_of(WIRES))
    assert found.shape == (2, FEATURES)
    backwards = features_of(image, cells, proposals_of(tuple(line[::-1] for line in WIRES)))
    np.testing.assert_allclose(backwards, found, atol=0.03)
    mirrored = tuple([[SIZE[1] - x, y] for x, y in line] for line in WIRES)
    flipped = np.ascontiguousarray(image[:, ::-1]), np.ascontiguousarray(cells[:, ::-1])
    np.testing.assert_allclose(features_of(*flipped, proposals_of(mirrored)), found, atol=0.06)


def test_tensors_round_trip_beside_the_network(tmp_path: Path) -> None:
    path, score = tmp_path / "w.safetensors", a_score()
    save_weights(path, tiny_net(), WeightsCard("a", "fast", TINY, 0.5), score)
    assert set(load_weights(path).net.state_dict()) == set(tiny_net().state_dict())
    loaded = read_line_score(read_weights(path))
    assert loaded is not None
    for name, tensor in score.tensors().items():
        np.testing.assert_array_equal(loaded.tensors()[name], tensor)


def test_weights_without_a_line_score_have_none(tmp_path: Path) -> None:
    assert read_line_score(read_weights(save_tiny(tmp_path / "w.safetensors"))) is None


def test_older_weights_have_a_score_without_a_context(tmp_path: Path) -> None:
    path, score = tmp_path / "w.safetensors", replace(a_score(), context=None)
    save_weights(path, tiny_net(), WeightsCard("a", "fast", TINY, 0.5), score)
    loaded = read_line_score(read_weights(path))
    assert loaded is not None
    assert loaded.context is None


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("blend", np.zeros(3, np.float32)),
        ("context.blend", np.zeros(3, np.float32)),
        ("context.0.weight", np.zeros((1, CONTEXT, 3), np.float32)),
        ("context.other", np.zeros(1, np.float32)),
        ("1.weight", np.zeros((2, 8, 5), np.float32)),
        ("mean", np.full((2, 1, FEATURES), np.nan, np.float32)),
        ("other", np.zeros(1, np.float32)),
    ],
)
def test_tensors_that_do_not_fit_are_refused(tmp_path: Path, name: str, value: np.ndarray) -> None:
    path = tmp_path / "w.safetensors"
    save_weights(path, tiny_net(), WeightsCard("a", "fast", TINY, 0.5), a_score())
    with safe_open(path, framework="np") as opened:
        metadata = opened.metadata()
    save_file(load_file(path) | {f"line_score.{name}": value}, path, metadata)
    with pytest.raises(LSNetError, match=r"not weights that this version can use .*line score"):
        Detector.load(path, runtime="torch")


def test_the_shipped_score_prefers_a_wire_to_a_kerb() -> None:
    """Both have the same segments; the wire has one ground on both sides, the kerb two."""
    score = read_line_score(read_weights("fast"))
    assert score is not None
    ground, line = textured(), ((0, 60), (319, 110))
    wire = cv2.line(ground.copy(), *line, (30, 30, 30), 3, cv2.LINE_AA)
    kerb = ground.copy()
    cv2.fillPoly(kerb, [np.array([*line, (319, 255), (0, 255)])], (190, 190, 190))
    cv2.line(kerb, *line, (110, 110, 110), 4, cv2.LINE_AA)
    cells = np.full((SIZE[0] // 16 - 1, SIZE[1] // 16 - 1), 0.1, np.float32)
    proposal = proposals_of(([[0.0, 60.5], [319.0, 110.5]],))
    on_wire, on_kerb = (score.rate(image, cells, proposal)[0] for image in (wire, kerb))
    assert on_wire > on_kerb + 0.1


def test_lines_out_of_reach_are_not_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    score, cells = a_score(), np.full((SIZE[0] // 16 - 1, SIZE[1] // 16 - 1), 0.1, np.float32)
    proposals = replace(proposals_of(WIRES), prior=np.array([0.01, 0.4]))
    every = score.rate(textured(), cells, proposals)
    some = score.rate(textured(), cells, proposals, min_score=0.5)
    assert some[1] == pytest.approx(every[1], abs=1e-6)
    assert some[0] == pytest.approx(1 / (1 + 99**0.7))  # odds of 1 in 99, to the power of their factor
    monkeypatch.setattr("lsnet.lines.score.features_of", None)
    assert (score.rate(textured(), cells, proposals, min_score=0.99) < 0.99).all()


def test_the_context_counts_whatever_the_least_score_is() -> None:
    """The second line is out of reach of 0.75, but context of the first."""
    score, cells = a_score(), np.full((SIZE[0] // 16 - 1, SIZE[1] // 16 - 1), 0.1, np.float32)
    proposals = replace(proposals_of(WIRES), prior=np.array([0.9, 0.04]))
    every, some = (score.rate(textured(), cells, proposals, least) for least in (0.0, 0.75))
    np.testing.assert_allclose(some, every, rtol=1e-6)
    alone = replace(score, context=None).rate(textured(), cells, proposals)
    odds = np.log(every / (1 - every)) - np.log(alone / (1 - alone))
    assert (np.abs(odds - 0.1) <= 0.5 * 2 + 1e-6).all()  # the evidence, limited, times its factor
    assert np.abs(odds - 0.1).max() > 1e-3
    small = replace(proposals, enlargement=3.0)
    features = features_of(textured(), cells, small)
    expected = score.first_logits(score.networks.logits(features), small.prior)
    np.testing.assert_allclose(score.rate(textured(), cells, small), 1 / (1 + np.exp(-expected)), rtol=1e-5)


@pytest.mark.parametrize("count", [0, 1, 20, 57])
def test_logits_are_those_of_the_formula(count: int) -> None:
    """However many lines there are; in float64, network by network and line by line."""
    nets = a_score().networks
    features = np.random.default_rng(count).normal(size=(count, FEATURES)).astype(np.float32)
    logits = nets.logits(features)
    assert logits.shape == (len(nets), count)
    for m, of_network in enumerate(logits):
        for own, logit in zip(features.astype(np.float64), of_network, strict=True):
            x = np.clip((own - nets.mean[m, 0]) / nets.deviation[m, 0], -4, 4)
            for k in range(2):
                x = np.maximum(x @ nets.weights[k][m] + nets.biases[k][m, 0], 0)
            assert logit == pytest.approx((x @ nets.weights[2][m] + nets.biases[2][m, 0]).item(), abs=1e-3)
