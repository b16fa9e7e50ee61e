"""A chart of accuracy against time as SVG: one point a network, the Pareto front as a line."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Sequence

WIDTH, HEIGHT, LEFT, TOP, RIGHT, BOTTOM = 720, 420, 60, 20, 150, 50


class Point(NamedTuple):
    """One network: milliseconds a frame and ODS."""

    name: str
    ms: float
    ods: float


def pareto_front(points: Sequence[Point]) -> list[Point]:
    """The points that none is both as fast and better than, or as good and faster, from fast to slow."""
    front: list[Point] = []
    for point in sorted(points, key=lambda p: (p.ms, -p.ods)):
        if not front or point.ods > front[-1].ods:
            front.append(point)
    return front


def chart(points: Sequence[Point], x_label: str, y_label: str) -> str:
    """The SVG text."""
    x_low, x_high = _range([p.ms for p in points])
    y_low, y_high = _range([p.ods for p in points])

    def place(point: Point) -> tuple[float, float]:
        x = LEFT + (point.ms - x_low) / (x_high - x_low) * (WIDTH - LEFT - RIGHT)
        y = HEIGHT - BOTTOM - (point.ods - y_low) / (y_high - y_low) * (HEIGHT - TOP - BOTTOM)
        return round(x, 1), round(y, 1)

    front = " ".join(f"{x},{y}" for x, y in map(place, pareto_front(points)))
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" '
        'font-family="sans-serif" font-size="12">',
        f'<rect width="{WIDTH}" height="{HEIGHT}" fill="white"/>',
        *_axes((x_low, x_high), (y_low, y_high), x_label, y_label),
        f'<polyline points="{front}" fill="none" stroke="#1f77b4"/>',
    ]
    for point in points:
        x, y = place(point)
        parts.append(f'<circle cx="{x}" cy="{y}" r="4" fill="#1f77b4"/>')
        parts.append(f'<text x="{x + 7}" y="{y + 4}">{escape(point.name)}</text>')
    return "\n".join([*parts, "</svg>\n"])


def _range(values: Sequence[float]) -> tuple[float, float]:
    """A little more than the values span."""
    low, high = min(values), max(values)
    spare = 0.08 * (high - low) or 1.0
    return low - spare, high + spare


def _axes(x: tuple[float, float], y: tuple[float, float], x_label: str, y_label: str) -> list[str]:
    bottom, right = HEIGHT - BOTTOM, WIDTH - RIGHT
    parts = [f'<path d="M{LEFT},{TOP} V{bottom} H{right}" fill="none" stroke="#444"/>']
    for i in range(5):
        across, up = LEFT + i / 4 * (right - LEFT), bottom - i / 4 * (bottom - TOP)
        parts.append(
            f'<text x="{across:.1f}" y="{bottom + 18}" text-anchor="middle">'
            f"{x[0] + i / 4 * (x[1] - x[0]):.1f}</text>"
        )
        value = y[0] + i / 4 * (y[1] - y[0])
        parts.append(f'<text x="{LEFT - 6}" y="{up + 4:.1f}" text-anchor="end">{value:.3f}</text>')
    middle = (LEFT + right) / 2
    parts.append(f'<text x="{middle}" y="{HEIGHT - 10}" text-anchor="middle">{escape(x_label)}</text>')
    parts.append(f'<text x="{LEFT}" y="{TOP - 6}">{escape(y_label)}</text>')
    return parts
