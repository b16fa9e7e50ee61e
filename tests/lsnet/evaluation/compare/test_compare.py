"""Comparisons of networks: fixed data, short trainings that continue, a table and a chart."""

from __future__ import annotations

import sys
import xml.etree.ElementTree as ET
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from evaluation_sets import write_masks
from hypothesis import given
from hypothesis import strategies as st
from nets import TINY

from lsnet import LSNetError
from lsnet.evaluation.compare import data as compare_data
from lsnet.evaluation.compare.chart import ChartPoint, draw_chart, pareto_front
from lsnet.evaluation.compare.compare import VARIANTS, Comparison, Variant, compare_all, results_of
from lsnet.evaluation.compare.data import Crops, draw_set
from lsnet.evaluation.compare.table import table
from lsnet.synth.backgrounds import BackgroundPool
from lsnet.synth.dataset import SyntheticScenes

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compare_data, "DRAWN_PX", 96)
    monkeypatch.setattr("lsnet.evaluation.compare.compare.VALIDATION_IMAGES", 2)


@pytest.mark.usefixtures("small")
def test_a_set_holds_the_drawn_images_and_their_lines(tmp_path: Path) -> None:
    draw_set(tmp_path, (), 6, seed=3, workers=0)
    whole = Crops.of(tmp_path, 0, 6, size=96, seed=0)
    scenes = SyntheticScenes(BackgroundPool([]), 96, seed=3)
    for i in range(6):
        np.testing.assert_array_equal(whole.images[i], scenes[i].image)
        assert len(whole.lines[i]) == len(scenes[i].lines)
        for ours, theirs in zip(whole.lines[i], scenes[i].lines, strict=True):
            np.testing.assert_array_equal(ours, theirs)
    assert any(whole.lines)
    kept = (tmp_path / "images.npy").stat().st_mtime_ns
    draw_set(tmp_path, (), 6, seed=3, workers=0)
    assert (tmp_path / "images.npy").stat().st_mtime_ns == kept
    with pytest.raises(LSNetError, match="holds 6 synthetic images, not 7; give another run folder"):
        draw_set(tmp_path, (), 7, seed=3, workers=0)


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


@pytest.mark.usefixtures("small")
def test_variants_with_a_result_are_not_run_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lsnet.evaluation.compare.compare.cpu_ms_of", lambda _network: {"torch": 1.5})
    comparison = Comparison(tmp_path, (), (write_masks(tmp_path / "masked"),), images=4, steps=2, crop=64)
    first, second = Variant("a", TINY), Variant("b", replace(TINY, stage_blocks=2))
    found: list[tuple[str, int]] = []
    rows = compare_all(comparison, (first,), workers=0)
    again = compare_all(comparison, (first, second), workers=0, report=lambda *words: found.append(words))
    assert again[0] == rows[0]
    assert {name for name, step in found if step} == {"b"}
    assert again[1].result.parameters > again[0].result.parameters
    assert set(results_of(comparison)) == {"a", "b"}
    assert 0 <= rows[0].result.ods["masked"] <= 1
    assert results_of(replace(comparison, steps=3)) == {}
    lines = table(again)
    assert lines[0] == "|  | parameters | validation loss | ODS masked | ms, torch |"
    assert [line.count("|") for line in lines] == [6] * 4
    assert lines[2].startswith("| a | ")
    assert lines[2].endswith(" | 1.5 |")
    with (tmp_path / "results.jsonl").open("a") as log:
        log.write("{")
    with pytest.raises(LSNetError, match=r"results\.jsonl: damaged; delete it"):
        compare_all(comparison, (first,), workers=0)


def test_variant_names_are_unique_and_consistent() -> None:
    by_name: dict[str, Variant] = {}
    for candidates in VARIANTS.values():
        assert len({c.name for c in candidates}) == len(candidates)
        for candidate in candidates:
            assert by_name.setdefault(candidate.name, candidate) == candidate


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
