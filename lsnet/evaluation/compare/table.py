"""What `model compare` prints and draws."""

from __future__ import annotations

from statistics import fmean
from typing import TYPE_CHECKING

from lsnet.errors import LSNetError
from lsnet.evaluation.compare.chart import Point, chart

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from lsnet.evaluation.compare.compare import Row


def table(rows: Sequence[Row]) -> list[str]:
    """A Markdown table, line by line."""
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
    """ODS, the mean of the sets, against time in the fastest runtime. Raises LSNetError."""
    runtime = min(rows[0].cpu_ms, key=lambda name: rows[0].cpu_ms[name])
    points = [Point(row.result.name, row.cpu_ms[runtime], fmean(row.result.ods.values())) for row in rows]
    svg = chart(
        points, f"CPU ms a frame of 512 x 512, one thread, {runtime}", "ODS at 1 px, mean of the sets"
    )
    try:
        path.write_text(svg, encoding="utf-8")
    except OSError as err:
        raise LSNetError(f"{path}: cannot be written ({err.strerror}); name another file") from err
