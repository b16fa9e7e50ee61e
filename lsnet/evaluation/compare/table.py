"""Table and chart of `model compare`."""

from __future__ import annotations

from statistics import fmean
from typing import TYPE_CHECKING

from lsnet.evaluation.compare.chart import ChartPoint, draw_chart

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from lsnet.evaluation.compare.compare import Row


def table(rows: Sequence[Row]) -> list[str]:
    """Return a Markdown table, line by line."""
    runtimes = list(rows[0].cpu_ms)
    sets = list(rows[0].result.ods)
    heads = ["", "parameters", "validation loss", *(f"ODS {name}" for name in sets)]
    heads += [f"ms, {name}" for name in runtimes]
    lines = [heads, ["---"] * len(heads)]
    for row in rows:
        result = row.result
        cells = [result.name, f"{result.parameters:,}", f"{result.validation_loss:.3f}"]
        cells += [f"{result.ods[name]:.3f}" for name in sets]
        lines.append(cells + [f"{row.cpu_ms[name]:.1f}" for name in runtimes])
    return ["| " + " | ".join(line) + " |" for line in lines]


def write_chart(rows: Sequence[Row], path: Path) -> None:
    """Draw the ODS, averaged over the sets, against the time in the fastest runtime. Raises LSNetError."""
    runtime = min(rows[0].cpu_ms, key=lambda name: rows[0].cpu_ms[name])
    points = [
        ChartPoint(row.result.name, row.cpu_ms[runtime], fmean(row.result.ods.values())) for row in rows
    ]
    x_label = f"CPU time per frame of 512 x 512 on one thread, ms ({runtime})"
    draw_chart(points, path, x_label, "ODS at 1 px, mean of the sets")
