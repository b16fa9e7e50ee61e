"""Tables and chart of `model compare` and `model ablate`."""

from __future__ import annotations

from itertools import groupby
from pathlib import PurePath
from statistics import fmean
from typing import TYPE_CHECKING

from lsnet.evaluation.compare.ablation import AblationRow
from lsnet.evaluation.compare.chart import ChartPoint, draw_chart

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from lsnet.evaluation.compare.compare import Row


def network_table(rows: Sequence[Row]) -> list[str]:
    """Return networks as a Markdown table, line by line."""
    runtimes = list(rows[0].cpu_ms)
    sets = list(rows[0].result.scores)
    heads = ["", "parameters", "validation loss", *(f"ODS {PurePath(name).name}" for name in sets)]
    heads += [f"ms, {name}" for name in runtimes]
    cells = []
    for row in rows:
        result = row.result
        of_row = [result.name, f"{result.parameters:,}", f"{result.validation_loss:.3f}"]
        of_row += [f"{result.scores[name]:.3f}" for name in sets]
        cells.append(of_row + [f"{row.cpu_ms[name]:.1f}" for name in runtimes])
    return _markdown(heads, cells)


def method_tables(rows: Sequence[AblationRow]) -> list[str]:
    """Return one Markdown table per ablation, line by line, with the paper's figures beside the measured."""
    lines: list[str] = []
    for what, of_table in groupby(rows, key=lambda row: row.what):
        heads = [what, *AblationRow.heads()[1:]]
        lines += [*([""] if lines else []), *_markdown(heads, [row.cells() for row in of_table])]
    return lines


def _markdown(heads: list[str], rows: Sequence[list[str]]) -> list[str]:
    return ["| " + " | ".join(cells) + " |" for cells in (heads, ["---"] * len(heads), *rows)]


def write_chart(rows: Sequence[Row], path: Path) -> None:
    """Draw the ODS, averaged over the sets, against the time in the fastest runtime. Raises LSNetError."""
    runtime = min(rows[0].cpu_ms, key=lambda name: rows[0].cpu_ms[name])
    points = [
        ChartPoint(row.result.name, row.cpu_ms[runtime], fmean(row.result.scores.values())) for row in rows
    ]
    x_label = f"CPU time per frame of 512 x 512 on one thread, ms ({runtime})"
    draw_chart(points, path, x_label, "ODS at 1 px, mean of the sets")
