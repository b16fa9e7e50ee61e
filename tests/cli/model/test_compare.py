"""`lsnet-pipe model compare|ablate`, on tiny networks and few images."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest
from evaluation_sets import write_masks
from model_commands import TINY_RUN, run
from nets import TINY

from lsnet.evaluation.compare import compare, trainings

if TYPE_CHECKING:
    from pathlib import Path


def test_compare_prints_a_table_and_draws_a_chart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compare, "NETWORKS", (compare.SizedVariant("small", TINY),))
    monkeypatch.setattr(compare, "cpu_ms_of", lambda _network: {"torch": 2.0, "openvino f32": 1.0})
    monkeypatch.setattr(trainings, "VALIDATION_IMAGES", 1)
    words = (
        "compare",
        write_masks(tmp_path / "m"),
        "--run",
        "run",
        "--images",
        2,
        "--steps",
        1,
        "--workers",
        0,
    )
    made = run(*words, "--chart", "chart.svg")
    assert (made.exit_code, made.stderr) == (0, "")
    assert made.stdout.splitlines()[0].endswith("| ODS m | ms, torch | ms, openvino f32 |")
    assert ">small<" in (tmp_path / "chart.svg").read_text()
    (rows,) = (json.loads(line) for line in run(*words, "--json").stdout.splitlines())
    assert rows["result"]["name"] == "small"
    assert rows["cpu_ms"] == {"torch": 2.0, "openvino f32": 1.0}
    other = run(*words, "--what", "rivals", "--chart", "chart.svg")
    assert "leave out --chart or --what rivals" in str(other.exception)


def test_ablate_prints_the_figures_of_the_paper_beside(tmp_path: Path) -> None:
    write_masks(tmp_path / "m")
    result = run("ablate", "m", *TINY_RUN)
    assert (result.exit_code, result.stderr) == (0, "")
    heads, _, *rows = result.stdout.splitlines()
    assert heads == "| grids | set | APR | ARR | F1 | F1 above LS-Net | paper: APR | ARR | F1 |"
    assert [row.split(" | ")[0] for row in rows] == [
        *("| LS-Net-1-M", "| LS-Net-2-MH", "| LS-Net-2-MV", "| LS-Net-2-MC"),
        *("| LS-Net-3-MHC", "| LS-Net-3-MVC", "| LS-Net-3-MVH", "| LS-Net-4-MHVC"),
    ]
    assert rows[0].endswith("| 0.8312 | 0.3791 | 0.4847 |")
    (first, *_) = run("ablate", "m", "--what", "grids", "--json", *TINY_RUN).stdout.splitlines()
    assert json.loads(first)["published"] == [0.8312, 0.3791, 0.4847]


def test_ablate_trains_in_the_folder_of_a_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trainings, "VALIDATION_IMAGES", 4)
    monkeypatch.setattr("lsnet.evaluation.compare.ablation.thin_paper", lambda _thinner: TINY)
    size = ("--images", 1, "--steps", 1, "--batch-size", 1, "--crop", 64, "--seeds", 1, "--workers", 0)
    words = ("ablate", write_masks(tmp_path / "m"), "--run", "run", "--what", "classification")
    result = run(*words, *size, "--device", "cpu")
    assert (result.exit_code, result.stderr) == (0, "")
    assert [row.split(" | ")[0] for row in result.stdout.splitlines()[2::2]] == ["| LS-Net-CE", "| LS-Net-FL"]
    assert run(*words, *size, "--device", "cpu").stdout == result.stdout


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "give --run to train, or --weights"),
        (("--run", "run", "--weights", "fast"), "give --run to train, or --weights"),
        (("--weights", "fast", "--what", "regression"), "only the ablation of the grids needs no training"),
        (("--run", "run", "--method", "wing"), "no method 'wing' to train; choose of LS-Net-P"),
    ],
)
def test_unusable_ablations_are_one_line(arguments: tuple[str, ...], message: str) -> None:
    assert message in str(run("ablate", "m", *arguments).exception)
