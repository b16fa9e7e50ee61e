"""Chart of accuracy over time by matplotlib (extra `plot`): one point per network, and the Pareto front."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from lsnet.errors import LSNetError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path


class ChartPoint(NamedTuple):
    """One network: milliseconds per frame and ODS."""

    name: str
    ms: float
    ods: float


def pareto_front(points: Sequence[ChartPoint]) -> list[ChartPoint]:
    """Return the points that no other beats in time or ODS without losing in the other, fastest first."""
    front: list[ChartPoint] = []
    for point in sorted(points, key=lambda p: (p.ms, -p.ods)):
        if not front or point.ods > front[-1].ods:
            front.append(point)
    return front


def draw_chart(points: Sequence[ChartPoint], path: Path, x_label: str, y_label: str) -> None:
    """Write the chart; the suffix of `path` decides the format (svg, png, pdf).

    Raises:
        LSNetError: matplotlib is not installed, does not know the format, or cannot write the file.
    """
    try:
        from matplotlib import rc_context  # noqa: PLC0415 - an extra
        from matplotlib.figure import Figure  # noqa: PLC0415
    except ImportError as err:
        raise LSNetError("matplotlib is not installed; pip install 'lsnet-pipe[plot]'") from err
    figure = Figure(figsize=(8, 4.5), layout="constrained")
    axes = figure.subplots()
    axes.set(xlabel=x_label, ylabel=y_label)
    axes.margins(0.15)  # room for names
    axes.plot([p.ms for p in points], [p.ods for p in points], "o")
    front = pareto_front(points)
    axes.plot([p.ms for p in front], [p.ods for p in front], color="C0")
    for point in points:
        axes.annotate(point.name, (point.ms, point.ods), (6, 4), textcoords="offset points", parse_math=False)
    try:
        with rc_context({"svg.fonttype": "none"}):  # text stays text
            figure.savefig(path)
    except (OSError, ValueError) as err:
        raise LSNetError(f"{path}: cannot be written ({err}); name another file, .svg or .png") from err
