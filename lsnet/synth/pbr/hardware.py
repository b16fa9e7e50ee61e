"""Line hardware: poles, lattice towers, strings of insulators.

All parts are rods: cylinders between two points, with a radius, in metres.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from lsnet.arrays import Floats, RealArray

    Triple = tuple[float, float, float]
    Rod = tuple[Triple, Triple, float]

DISC_M, PITCH_M = 0.127, 0.146  # radius and spacing of cap-and-pin insulators (IEC 60305, U70 and U120)
PIN_M = 0.03


def triple(vector: RealArray) -> Triple:
    """Return a vector as a tuple x, y, z, as Mitsuba takes it."""
    x, y, z = vector.tolist()
    return x, y, z


def pole(foot: Floats, height_m: float, radius_m: float) -> list[Rod]:
    """Return one upright rod."""
    return [(triple(foot), triple(foot + np.array([0, 0, height_m])), radius_m)]


def lattice_tower(foot: Floats, height_m: float, width_m: float, n_panels: int) -> list[Rod]:
    """Return four legs that converge to a third of their distance, with crossed braces on each side."""
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) / 2
    levels = np.linspace(0, 1, n_panels + 1)
    rings = [foot + corners * width_m * (1 - 2 * t / 3) + [0, 0, t * height_m] for t in levels]
    leg_m = 0.03 * width_m
    rods = [(triple(rings[0][k]), triple(rings[-1][k]), leg_m) for k in range(4)]
    for below, above in pairwise(rings):
        for k in range(4):
            left, right = k, (k + 1) % 4
            for start, end in ((left, right), (right, left)):
                rods.append((triple(below[start]), triple(above[end]), leg_m / 2))
    return rods


def insulators(below: Floats, n_discs: int) -> list[Rod]:
    """Return a string of discs on a pin that holds a cable from above; `below` is its lower end."""
    up = np.array([0.0, 0.0, PITCH_M])
    pin = (triple(below), triple(below + up * (n_discs + 1)), PIN_M)
    discs = [
        (triple(below + up * (k - 0.2)), triple(below + up * (k + 0.2)), DISC_M)
        for k in range(1, n_discs + 1)
    ]
    return [pin, *discs]
