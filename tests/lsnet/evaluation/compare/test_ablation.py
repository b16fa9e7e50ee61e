"""The tables of the paper: their methods, their figures, and a short run of each on tiny networks."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from evaluation_sets import write_masks

from lsnet import LSNetError
from lsnet.evaluation.baselines import learned
from lsnet.evaluation.baselines.wd_dcnn import WDDCNNConfig
from lsnet.evaluation.baselines.wsl_cnn import WSLCNNConfig
from lsnet.evaluation.compare import data as compare_data
from lsnet.evaluation.compare import rivals
from lsnet.evaluation.compare import trainings as compare_trainings
from lsnet.evaluation.compare.ablation import (
    ABLATIONS,
    AblationRow,
    Published,
    ablate,
    ablate_grids,
    count_trainings,
    thin_paper,
    with_leads,
)
from lsnet.evaluation.compare.table import method_tables
from lsnet.evaluation.compare.trainings import Comparison, Trainings
from lsnet.images import load_rgb
from lsnet.network_config import PRESETS, LSNetConfig
from lsnet.segments import Detections, Lines, Segments

if TYPE_CHECKING:
    from pathlib import Path

THIN = LSNetConfig(stage_channels=(2, 2, 2, 2), head_channels=2, norm="batch")


@pytest.fixture
def trainings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Trainings:
    for module in (compare_data, compare_trainings):
        monkeypatch.setattr(module, "DRAWN_PX", 128)
    monkeypatch.setattr(compare_trainings, "VALIDATION_IMAGES", 1)
    sets = (write_masks(tmp_path / "masked"),)
    comparison = Comparison(tmp_path, (), sets, images=2, steps=1, batch_size=1, crop=128, device="cpu")
    return Trainings(comparison, workers=0)


def test_figures_of_the_paper_agree_between_its_tables() -> None:
    """LS-Net itself is the last row of each, the best F1 of all; APR falls and ARR rises with the grids."""
    for methods in ABLATIONS.values():
        own = methods[-1]
        assert (own.published.f1, own.network, own.loss, own.grids) == (0.5940, None, None, "MHVC")
        assert own.published.f1 == max(method.published.f1 for method in methods)
    counts = [len(method.grids) for method in ABLATIONS["grids"]]
    assert counts == sorted(counts)
    one, *_, four = ABLATIONS["grids"]
    assert one.published.apr > four.published.apr
    assert one.published.arr < four.published.arr


def test_thin_networks_keep_the_table_of_the_paper() -> None:
    assert thin_paper(1) == PRESETS["paper"]
    assert thin_paper(4).stage_channels == (16, 32, 64, 128)
    assert replace(thin_paper(4), stage_channels=(64, 128, 256, 512), head_channels=512) == PRESETS["paper"]
    with pytest.raises(LSNetError, match="channels cannot be divided by 3; give 1, 2, 4 or 8"):
        thin_paper(3)


def test_every_method_of_the_ablations_is_trained_and_scored(trainings: Trainings) -> None:
    rows = ablate(trainings, THIN, seeds=1)
    assert len(rows) == 2 * sum(
        len(methods) for methods in ABLATIONS.values()
    )  # the set, and held-out images
    assert all(np.shape(row.values) == (1, 3) for row in rows)
    trained = list((trainings.comparison.folder / "runs").iterdir())
    assert len(trained) == 1 + 1 + 3 + 1  # LS-Net, pooling, three regression losses, cross-entropy
    assert count_trainings(2, list(ABLATIONS)) == len(rows)
    lines = method_tables(rows)
    assert lines.count("") == 3
    assert lines[0] == "| downsample | set | APR | ARR | F1 | F1 above LS-Net | paper: APR | ARR | F1 |"
    assert lines[4].startswith("| LS-Net-S | masked | ")
    assert lines[5].startswith("| LS-Net-S | held_out | ")
    assert lines[5].endswith(" | - | 0.8004 | 0.5368 | 0.5940 |")
    assert ablate(trainings, THIN, 1, ["grids"]) == [row for row in rows if row.what == "grids"]
    few = ablate(trainings, THIN, 1, ["regression"], ["LS-Net-1 (L1)"])
    assert [row.method for row in few[::2]] == ["LS-Net-1 (L1)", "LS-Net-W (Wing)"]
    with pytest.raises(LSNetError, match="no method 'LS-Net-CE' to train; choose of LS-Net-2"):
        ablate(trainings, THIN, 1, ["regression"], ["LS-Net-CE"])


def test_held_out_images_have_their_lines_as_truth(trainings: Trainings) -> None:
    images, lines = trainings.drawn / "images.npy", 0
    for image in sorted((trainings.sets[-1] / "images").iterdir()):
        which = int(image.stem)
        assert which >= trainings.comparison.images
        np.testing.assert_array_equal(load_rgb(image), np.load(images)[which])
        with np.load(trainings.drawn / "lines.npz") as kept:
            ends = np.cumsum(kept["counts"])
            of_image = [kept["points"][e - n : e] for e, n in zip(ends, kept["counts"], strict=True)]
            owners = kept["image"]
        mask = load_rgb(image.parent.parent / "masks" / image.name)[..., 0] > 0
        inside = [p for k, line in zip(owners, of_image, strict=True) if k == which for p in line]
        for x, y in (p for p in inside if ((p > 1) & (p < 126)).all()):
            assert mask[int(y), int(x)]
            lines += 1
    assert lines


def test_several_seeds_have_a_mean_and_a_deviation() -> None:
    values = [[0.5, 0.25, 0.25], [0.7, 0.25, 0.35]]
    row = AblationRow("regression", "L2", "sets/m", values, Published(0.1, None, 0.2))
    own = AblationRow("regression", "Wing", "sets/m", [[0, 0, 0.1], [0, 0, 0.4]], Published(0, 0, 0))
    single = AblationRow("regression", "LSD", "sets/m", [[0, 0, 0.2]], Published(None, None, None))
    first, *others = with_leads([row, own, single], "Wing")
    assert first.cells() == [
        *("L2", "m", "0.600 ± 0.141", "0.250 ± 0.000", "0.300 ± 0.071", "+0.050 ± 0.141"),
        *("0.1000", "-", "0.2000"),
    ]
    assert [other.cells()[5] for other in others] == ["-", "-"]


class ByGrid:
    """Finds the cable if the central grid is used, else nothing."""

    def __init__(self, grids: str) -> None:
        self._grids = grids

    def detect(self, images: list[np.ndarray]) -> list[Detections]:
        ends = np.array([[0, 31.5, 79.9, 31.5]], np.float32)[: "C" in self._grids]
        size = images[0].shape[:2]
        return [Detections(Segments(ends, np.ones(len(ends), np.float32), size), Lines.empty(size))]


def test_the_grids_of_weights_are_scored_without_training(tmp_path: Path) -> None:
    rows = ablate_grids(ByGrid, [write_masks(tmp_path / "masked")])
    assert {row.method: row.values[0] for row in rows} == {
        method.name: pytest.approx([1, 0.25, 0.4] if "C" in method.grids else [0, 0, 0])
        for method in ABLATIONS["grids"]
    }
    assert method_tables(rows)[2] == (
        "| LS-Net-1-M | masked | 0.000 | 0.000 | 0.000 | -0.400 | 0.8312 | 0.3791 | 0.4847 |"
    )


def test_every_rival_is_trained_and_scored(trainings: Trainings, monkeypatch: pytest.MonkeyPatch) -> None:
    tiny = {
        name: replace(config, channels=(2,) * 5)
        if isinstance(config, WSLCNNConfig)
        else replace(config, channels=2, dilations=(1, 2))
        for name, config in learned.RIVALS.items()
    }
    monkeypatch.setattr(rivals, "RIVALS", tiny)
    monkeypatch.setattr(rivals, "thinned", lambda config, _thinner: config)
    monkeypatch.setattr(rivals, "thin_paper", lambda _thinner: THIN)
    rows = rivals.compare_rivals(trainings, 4, seeds=1)
    assert [row.method for row in rows[::2]] == [*rivals.PUBLISHED, *rivals.UNTRAINED]
    assert rivals.rivals_of(["WD-DCNN-GN"]) == ["wd-dcnn-gn"]
    by_name = {row.method: row for row in rows[::2]}
    assert by_name["LS-Net-W2"].published.f1 == 0.5344
    assert by_name["LSD, 2 px"].values[0][1] > 0  # of its edges some are in the band
    assert all(0 <= value <= 1 for row in rows for value in row.values[0])
    assert method_tables(rows)[2].endswith("| - | 0.6256 | - |")


def test_rivals_are_thinned_like_the_network() -> None:
    assert rivals.thinned(WDDCNNConfig(focal=True), 4) == WDDCNNConfig(channels=8, focal=True)
    assert rivals.thinned(WSLCNNConfig(), 2).channels == (32, 64, 128, 256, 256)
