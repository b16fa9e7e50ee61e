"""Comparisons of networks: fixed data, short trainings that continue, a table and a chart."""

from __future__ import annotations

import sys
import xml.etree.ElementTree as ET
from dataclasses import replace
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest
from evaluation_sets import write_masks
from hypothesis import given, settings
from hypothesis import strategies as st
from nets import TINY

from lsnet import LSNetError
from lsnet.evaluation.compare import data as compare_data
from lsnet.evaluation.compare import trainings as compare_trainings
from lsnet.evaluation.compare.chart import ChartPoint, draw_chart, pareto_front
from lsnet.evaluation.compare.compare import NETWORKS, SizedVariant, compare_networks
from lsnet.evaluation.compare.data import Crops, draw_set
from lsnet.evaluation.compare.table import network_table
from lsnet.evaluation.compare.trainings import Comparison, Trainings, Variant, results_of
from lsnet.synth.backgrounds import BackgroundPool
from lsnet.synth.dataset import SyntheticScenes
from lsnet.synth.paper import PaperScenes
from lsnet.training.losses import MultiTaskLoss
from lsnet.training.tasks import LSNetTask

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compare_data, "DRAWN_PX", 96)
    monkeypatch.setattr(compare_trainings, "DRAWN_PX", 96)
    monkeypatch.setattr(compare_trainings, "VALIDATION_IMAGES", 2)


@pytest.mark.usefixtures("small")
@pytest.mark.parametrize(("kind", "as_paper"), [(SyntheticScenes, False), (PaperScenes, True)])
def test_a_set_holds_the_drawn_images_and_their_lines(
    tmp_path: Path, kind: type[SyntheticScenes | PaperScenes], as_paper: bool
) -> None:
    draw_set(tmp_path, (), 6, seed=3, workers=0, as_paper=as_paper)
    whole = Crops.of(tmp_path, 0, 6, size=96, seed=0)
    scenes = kind(BackgroundPool([]), 96, seed=3)
    for i in range(6):
        np.testing.assert_array_equal(whole.images[i], scenes[i].image)
        assert len(whole.lines[i]) == len(scenes[i].lines)
        for ours, theirs in zip(whole.lines[i], scenes[i].lines, strict=True):
            np.testing.assert_array_equal(ours, theirs)
    assert any(whole.lines)
    kept = (tmp_path / "images.npy").stat().st_mtime_ns
    draw_set(tmp_path, (), 6, seed=3, workers=0)
    assert (tmp_path / "images.npy").stat().st_mtime_ns == kept


def test_crops_move_the_lines_with_the_image() -> None:
    image = np.zeros((1, 60, 60, 3), np.uint8)
    points = np.array([[12.0, 20.0], [30.0, 41.0], [47.0, 31.0]])
    for x, y in points.astype(int):
        image[0, y, x] = 255
    crops = Crops(image, [[points + 0.5]], 0, 1, size=48, seed=0)
    seen = 0
    for i in range(20):
        sample = crops[i]
        for x, y in sample.lines[0]:
            if 0 <= x < 48 and 0 <= y < 48:
                assert sample.image[int(y), int(x)].tolist() == [255] * 3
                seen += 1
        np.testing.assert_array_equal(sample.image, crops[i].image)
    assert seen > 30
    np.testing.assert_array_equal(points, [[12, 20], [30, 41], [47, 31]])


@pytest.fixture
def comparison(tmp_path: Path, small: None) -> Comparison:
    return Comparison(tmp_path, (), (write_masks(tmp_path / "masked"),), images=4, steps=2, crop=64)


def test_variants_with_a_result_are_not_run_again(
    comparison: Comparison, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lsnet.evaluation.compare.compare.cpu_ms_of", lambda _network: {"torch": 1.5})
    first, second = SizedVariant("a", TINY), SizedVariant("b", replace(TINY, stage_blocks=2))
    found: list[tuple[str, int]] = []
    rows = compare_networks(Trainings(comparison, workers=0), (first,))
    trainings = Trainings(comparison, workers=0, report=lambda *words: found.append(words))
    again = compare_networks(trainings, (first, second))
    assert again[0] == rows[0]
    assert found == [
        ("a", 2),
        ("b, seed 0", 3),
        ("b, seed 0", 4),
        ("b", 4),
    ]  # nothing is drawn or trained of a
    assert again[1].result.parameters > again[0].result.parameters
    (ods,) = rows[0].result.scores.values()
    assert 0 <= ods <= 1
    lines = network_table(again)
    assert lines[0] == "|  | parameters | validation loss | ODS masked | ms, torch |"
    assert [line.count("|") for line in lines] == [6] * 4
    assert lines[2].startswith("| a | ")
    assert lines[2].endswith(" | 1.5 |")
    with (comparison.folder / "results.jsonl").open("a") as log:
        log.write("{")
    with pytest.raises(LSNetError, match=r"results\.jsonl: damaged, or of an older version; delete it"):
        compare_networks(Trainings(comparison, workers=0), (first,))


def test_results_belong_to_their_data_network_loss_and_seed(comparison: Comparison) -> None:
    """Each change gives a result of its own; what is as before gives the kept one."""
    counts = iter(range(100))

    def scored(comparison: Comparison, variant: Variant, kind: str = "count") -> object:
        trainings = Trainings(comparison, workers=0)
        return trainings.score(variant, kind, lambda _net: {"count": next(counts)}).scores["count"]

    folder = comparison.folder
    photos = folder / "photos"
    photos.mkdir()
    cv2.imwrite(str(photos / "a.png"), np.full((70, 70, 3), 50, np.uint8))
    tiny = Variant("a", LSNetTask(TINY))
    over_photos = replace(comparison, backgrounds=(str(photos),))
    cases = [
        (comparison, tiny),
        (over_photos, tiny),
        (comparison, replace(tiny, task=LSNetTask(replace(TINY, head_channels=4)))),
        (comparison, replace(tiny, task=LSNetTask(TINY, MultiTaskLoss(gamma=1.0)))),
        (comparison, replace(tiny, seed=1)),
        (replace(comparison, steps=1), tiny),
        (replace(comparison, images=3), tiny),
        (replace(comparison, as_paper=True), tiny),
        (replace(comparison, sets=(write_masks(folder / "other/masked"),)), tiny),
    ]
    # The other set has the same images and the same name: its result is the kept one.
    assert [scored(*case) for case in cases] == [0, 1, 2, 3, 4, 5, 6, 7, 0]
    assert scored(comparison, replace(tiny, name="renamed")) == 0
    assert scored(comparison, tiny, "another way of scoring") == 8
    cv2.imwrite(str(photos / "a.png"), np.full((70, 70, 3), 51, np.uint8))
    assert scored(over_photos, tiny) == 9
    cv2.imwrite(str(folder / "masked/masks/a.png"), np.zeros((64, 80), np.uint8))
    assert scored(comparison, tiny) == 10
    assert len(results_of(folder)) == 11


@pytest.mark.usefixtures("small")
def test_sets_without_truth_and_large_crops_are_one_line(tmp_path: Path) -> None:
    (tmp_path / "plain").mkdir()
    cv2.imwrite(str(tmp_path / "plain/a.png"), np.zeros((70, 70, 3), np.uint8))
    with pytest.raises(LSNetError, match="plain: has no pixel truth"):
        Trainings(Comparison(tmp_path, (), (tmp_path / "plain",), images=1, crop=64), workers=0)
    assert [path.name for path in tmp_path.iterdir()] == ["plain"]  # nothing was drawn
    with pytest.raises(LSNetError, match="crops of 128 px do not fit the drawn images; give at most 96"):
        Comparison(tmp_path, (), (), crop=128)


def test_names_of_networks_are_unique() -> None:
    assert len({network.name for network in NETWORKS}) == len(NETWORKS)


@settings(deadline=None)  # a busy machine is no failure
@given(st.lists(st.tuples(st.integers(1, 9), st.integers(1, 9)), min_size=1))
def test_nothing_beats_the_pareto_front(pairs: list[tuple[int, int]]) -> None:
    points = [ChartPoint(str(i), ms, ods) for i, (ms, ods) in enumerate(pairs)]
    front = pareto_front(points)
    for point in points:
        beaten = [p for p in points if p.ms <= point.ms and p.ods >= point.ods and p[1:] != point[1:]]
        assert (point[1:] in [p[1:] for p in front]) == (not beaten)


def test_a_chart_names_every_network(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    points = [ChartPoint("a & b", 5.0, 0.7), ChartPoint("$slow_", 15.0, 0.8), ChartPoint("worse", 10.0, 0.6)]
    draw_chart(points, tmp_path / "chart.svg", "ms", "ODS")
    root = ET.parse(tmp_path / "chart.svg")  # noqa: S314
    texts = {"".join(text.itertext()) for text in root.iter("{http://www.w3.org/2000/svg}text")}
    assert {"a & b", "$slow_", "worse", "ms", "ODS"} <= texts
    draw_chart(points[:1], tmp_path / "one.png", "ms", "ODS")
    assert (tmp_path / "one.png").read_bytes().startswith(b"\x89PNG")
    for path in (tmp_path / "none" / "chart.svg", tmp_path / "chart.nonesuch"):
        with pytest.raises(LSNetError, match="cannot be written") as error:
            draw_chart(points, path, "ms", "ODS")
        assert "\n" not in str(error.value)


def test_a_missing_matplotlib_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(LSNetError, match=r"not installed; pip install 'lsnet-pipe\[plot\]'"):
        draw_chart([ChartPoint("a", 5.0, 0.7)], tmp_path / "chart.svg", "ms", "ODS")
