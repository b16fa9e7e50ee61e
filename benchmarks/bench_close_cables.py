"""Detection of two cables that are close together or cross: how often both are found as separate lines.

    python benchmarks/bench_close_cables.py [--images 40] [--weights fast]

Two cables of 2 to 4 px are drawn over a plain ground, parallel at a spacing between their centrelines, or
crossing at an angle in the middle of a 384 px image. A cable is found when a line of its own follows at least
80 % of it and never leaves it by more than a third of the spacing, at most 2 px.
Cells are 16 px apart and have one segment each. The last line is one JSON object.
"""

from __future__ import annotations

import argparse
import json
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from lsnet import Detector
from lsnet.synth.backgrounds import plain
from lsnet.synth.cables import Arc, Finish, draw_cable

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    Float = NDArray[np.float64]
    Pair = tuple[Arc, Arc]

SIZE = 384
SPACINGS_PX = (4, 6, 8, 10, 12, 16, 20, 24, 32)
ANGLES_DEG = (5, 10, 15, 20, 30, 45, 60, 90)


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--images", type=int, default=40, help="of each spacing and angle")
    parser.add_argument("--weights", default="fast")
    arguments = parser.parse_args()
    detector = Detector.load(arguments.weights)
    result: dict[str, object] = {"benchmark": "close cables", "images": arguments.images}
    for name, values, pair in (("spacing_px", SPACINGS_PX, parallel), ("angle_deg", ANGLES_DEG, crossing)):
        print(f"{name:>10}  {'both':>6}  {'one':>6}")
        shares = {}
        for value in values:
            n_found = [count_found(detector, pair, value, seed) for seed in range(arguments.images)]
            shares[value] = {n: n_found.count(n) / len(n_found) for n in (2, 1)}
            print(f"{value:10d}  {shares[value][2]:6.0%}  {shares[value][1]:6.0%}", flush=True)
        result[name] = {str(value): share[2] for value, share in shares.items()}
    print(json.dumps(result))


def parallel(spacing_px: float, rng: np.random.Generator) -> tuple[Pair, float]:
    """Return two parallel cables, and the tolerance of lines."""
    angle, centre = rng.uniform(0, np.pi), rng.uniform(0.4, 0.6, 2) * SIZE
    across = np.array([-np.sin(angle), np.cos(angle)]) * spacing_px / 2
    return (through(centre - across, angle), through(centre + across, angle)), min(spacing_px / 3, 2.0)


def crossing(angle_deg: float, rng: np.random.Generator) -> tuple[Pair, float]:
    """Return two cables that cross near the middle."""
    angle, centre = rng.uniform(0, np.pi), rng.uniform(0.4, 0.6, 2) * SIZE
    return (through(centre, angle), through(centre, angle + np.radians(angle_deg))), 2.0


def through(point: Float, angle: float) -> Arc:
    """Return a straight cable that crosses the image."""
    reach = np.array([np.cos(angle), np.sin(angle)]) * 2 * SIZE
    (x1, y1), (x2, y2) = point - reach, point + reach
    return Arc((x1, y1), (x2, y2), 0.0)


def count_found(
    detector: Detector,
    pair: Callable[[float, np.random.Generator], tuple[Pair, float]],
    value: float,
    seed: int,
) -> int:
    """Return how many of the two cables of a drawn image are found."""
    rng = np.random.default_rng([seed, int(value)])
    arcs, tolerance_px = pair(value, rng)
    image = plain(rng, SIZE)
    bright = 255.0 if image.mean() < 128 else 20.0
    finish = Finish((bright,) * 3, ambient=0.5, diffuse=0.5, specular=0.0, light=0.3, strand_px=0.0)
    width_px = rng.uniform(2, 4) if value >= 6 else 2.0
    for arc in arcs:
        draw_cable(image, arc, (width_px, width_px), finish)
    pixels = np.clip(np.round(image), 0, 255).astype(np.uint8)
    lines = list(detector.detect([pixels])[0].lines.points)
    n_found = 0
    for arc in arcs:
        shares = [share_followed(arc, line, tolerance_px) for line in lines]
        if shares and max(shares) >= 0.8:
            n_found += 1
            lines.pop(int(np.argmax(shares)))
    return n_found


def share_followed(arc: Arc, line: Sequence[Sequence[float]], tolerance_px: float) -> float:
    """Return the share of the points of a cable in the image that are within the tolerance of a line."""
    points = arc.points(1600)
    points = points[((points >= 0) & (points < SIZE)).all(axis=1)]
    nearest = np.full(len(points), np.inf)
    vertices = np.asarray(line, float)
    for start, end in pairwise(vertices):
        step = end - start
        t = np.clip((points - start) @ step / max(step @ step, 1e-9), 0, 1)
        nearest = np.minimum(nearest, np.hypot(*(points - start - t[:, None] * step).T))
    return float((nearest <= tolerance_px).mean()) if len(points) else 1.0


if __name__ == "__main__":
    main()
