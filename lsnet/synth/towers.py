"""Towers from near: lattice steel, strings of insulators, grading rings, and the wires that end there.

Steel, strings and rings are background; conductors and jumpers are lines, however short. Images are uint8
(H, W, 3) RGB and are painted in place.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from lsnet.synth.brush import direction, put, stroke
from lsnet.synth.cables import Arc, draw_cable

if TYPE_CHECKING:
    from lsnet.arrays import Floats, ImageArray, Points, Rng
    from lsnet.synth.cables import Finish


def add_tower(image: ImageArray, rng: Rng, finish: Finish) -> list[Points]:
    """Draw a tower with its strings and wires; return the centrelines of the wires, pixels.

    Args:
        image: uint8 (H, W, 3), painted in place.
        rng: Random numbers.
        finish: Appearance of the wires.
    """
    height, width = image.shape[:2]
    for _ in range(int(rng.integers(0, 3))):  # far ones
        tall, at = rng.uniform(0.15, 0.5) * height, rng.uniform(0, 1, 2) * (width, height)
        _lattice(image, rng, at, at - (rng.normal(0, 0.05) * tall, tall), width_px=0.3 * tall, member_px=1.0)
    centre = rng.uniform(-0.05, 1.05) * width
    lean, wide = rng.normal(0, 0.12) * height, rng.uniform(0.12, 0.4) * width
    bottom, top = np.array([centre, 1.1 * height]), np.array([centre + lean, -0.1 * height])
    member = float(np.exp(rng.uniform(np.log(1.5), np.log(0.016 * height + 1.6))))
    wires: list[Points] = []
    side = 1.0 if centre < width / 2 else -1.0
    layer = _WirePainter(image, rng, finish)
    in_front = rng.random() < 0.5
    if in_front:
        _lattice(image, rng, bottom, top, width_px=wide, member_px=member)
    for _ in range(int(rng.integers(1, 4))):
        share = rng.uniform(0.05, 0.9)
        foot = top + (bottom - top) * share + (side * wide * rng.uniform(0.0, 0.5), 0)
        wires += _dead_end(image, rng, layer, foot, side)
    if rng.random() < 0.4:
        wires += _hung_jumper(image, rng, layer)
    if not in_front:
        _lattice(image, rng, bottom, top, width_px=wide, member_px=member)
    return wires


@dataclass(frozen=True, slots=True)
class _WirePainter:
    """Draw bundles of one finish."""

    image: ImageArray
    rng: Rng
    finish: Finish

    def bundle(self, arc: Arc, count: int, spacing_px: float, width_px: float) -> list[Points]:
        """Draw `count` wires side by side along an arc, with spacers; return their centrelines."""
        chord = np.array(arc.end) - np.array(arc.start)
        across = np.array([-chord[1], chord[0]]) / max(float(np.hypot(*chord)), 1e-9)
        places = (np.arange(count) - (count - 1) / 2) * spacing_px
        drawn, picture = [], self.image.astype(np.float32)
        narrowing = self.rng.uniform(0.5, 1.0)
        for place in places:
            begin, end = np.array(arc.start) + across * place, np.array(arc.end) + across * place * narrowing
            sag = arc.sag_px * self.rng.uniform(0.96, 1.04)
            one = Arc((begin[0], begin[1]), (end[0], end[1]), sag)
            draw_cable(picture, one, (width_px, width_px * narrowing), self.finish)
            drawn.append(one.points(33))
        put(self.image, picture)
        if count > 1:
            self._spacers(drawn, width_px)
        return drawn

    def _spacers(self, drawn: list[Points], width_px: float) -> None:
        tone = np.full(3, self.rng.uniform(20, 90))
        for k in self.rng.integers(2, 31, int(self.rng.integers(0, 3))):
            first, last = drawn[0][k], drawn[-1][k]
            stroke(self.image, np.stack([first, last]), tone, 1.6 * width_px + 1)
            for line in drawn:
                stroke(
                    self.image, line[k] + np.array([[-1.0, 0], [1.0, 0]]) * width_px, tone, 2 * width_px + 1
                )


def _lattice(
    image: ImageArray, rng: Rng, bottom: Floats, top: Floats, *, width_px: float, member_px: float
) -> None:
    """Draw a braced tower between two points: legs, crosses, struts and a second face behind."""
    grey = rng.uniform(45, 215)
    rgb = np.clip(grey + rng.normal(0, 8, 3), 0, 255)
    taper, bays = rng.uniform(0.4, 1.0), int(rng.integers(4, 10))
    shift = np.array([rng.uniform(-0.3, 0.3) * width_px, rng.uniform(-0.03, 0.03) * image.shape[0]])
    for face, shade in ((shift, 0.7), (np.zeros(2), 1.0)):
        t = np.linspace(0, 1, bays + 1)[:, None]
        middle = bottom + (top - bottom) * t + face
        half = np.array([width_px / 2, 0]) * (1 - (1 - taper) * t)
        left, right = middle - half, middle + half
        for k in range(bays):
            pairs = [(left[k], right[k + 1]), (right[k], left[k + 1])]
            pairs += [(left[k], right[k])] * (rng.random() < 0.7)
            centre = (left[k] + right[k + 1]) / 2
            pairs += [(centre, (left[k] + left[k + 1]) / 2), (centre, (right[k] + right[k + 1]) / 2)]
            for a, b in pairs:
                tone = np.clip(rgb * shade * rng.uniform(0.75, 1.25), 0, 255)
                _member(image, np.stack([a, b]), tone, member_px * rng.uniform(0.5, 1.0), rng)
        for leg in (left, right):
            tone = np.clip(rgb * shade * rng.uniform(0.75, 1.25), 0, 255)
            _member(image, leg, tone, member_px * rng.uniform(1.2, 2.2), rng)


def _member(image: ImageArray, points: Floats, rgb: Floats, width_px: float, rng: Rng) -> None:
    """Draw an angle profile: a bright flange beside a dark one, the darker without light."""
    stroke(image, points, rgb, width_px)
    if width_px > 3 and rng.random() < 0.7:
        stroke(image, points + rng.choice([-1, 1]) * width_px / 3, rgb * rng.uniform(0.4, 0.8), width_px / 2)


def _dead_end(image: ImageArray, rng: Rng, wires: _WirePainter, foot: Floats, side: float) -> list[Points]:
    """Draw one phase of a strain tower: string, rings, conductors to the border, and the jumper below."""
    height, width = image.shape[:2]
    size = max(height, width)
    along = direction(rng.normal(0, 0.16)) * (side, 1)
    end = foot + along * rng.uniform(0.12, 0.36) * size
    disc = rng.uniform(0.006, 0.03) * size
    twin = disc * 1.2 if rng.random() < 0.5 else 0.0
    count = int(rng.choice([1, 2, 4], p=[0.35, 0.3, 0.35]))
    # Bundles keep the proportion of disc and wire: both are seen from the same distance.
    wire_px = float(np.clip(disc * rng.uniform(0.12, 0.25), 0.9, 9))
    spacing = disc * rng.uniform(0.7, 2.2)
    drawn: list[Points] = []
    if rng.random() < 0.85:
        turned = direction(np.arctan2(along[1], along[0]) + rng.normal(0, 0.12))
        far = end + turned * 1.3 * size
        drawn += wires.bundle(_arc(end, far, rng.normal(0.01, 0.01) * size), count, spacing, wire_px)
    if rng.random() < 0.85:
        reach = np.array([-side * rng.uniform(-0.15, 0.5), rng.uniform(-0.2, 0.6)]) * size
        sag = -side * rng.uniform(0.04, 0.28) * float(np.hypot(*reach))
        drawn += wires.bundle(_arc(end, end + reach, sag), count, spacing * rng.uniform(0.6, 1.2), wire_px)
    for offset in (-twin, twin) if twin else (0.0,):
        _string(image, rng, foot + np.array([0, offset]), end + np.array([0, offset / 2]), disc)
    _rings(image, rng, end, disc)
    return drawn


def _hung_jumper(image: ImageArray, rng: Rng, wires: _WirePainter) -> list[Points]:
    """Draw a jumper that a vertical string holds up in the middle: two arcs that meet at it."""
    height, width = image.shape[:2]
    size = max(height, width)
    at = rng.uniform(0.15, 0.85, 2) * (width, 0.6 * height)
    disc, count = rng.uniform(0.006, 0.02) * size, int(rng.choice([1, 2, 4]))
    wire_px, drawn = float(np.clip(disc * rng.uniform(0.15, 0.3), 0.9, 8)), []
    for side in (-1, 1):
        reach = np.array([side * rng.uniform(0.12, 0.5), rng.uniform(0.02, 0.4)]) * size
        sag = side * rng.uniform(0.05, 0.2) * float(np.hypot(*reach))
        drawn += wires.bundle(_arc(at, at + reach, sag), count, disc * rng.uniform(0.8, 2), wire_px)
    _string(image, rng, at - (0, rng.uniform(0.05, 0.3) * size), at, disc)
    return drawn


def _arc(start: Floats, end: Floats, sag_px: float) -> Arc:
    return Arc((float(start[0]), float(start[1])), (float(end[0]), float(end[1])), float(sag_px))


def _string(image: ImageArray, rng: Rng, start: Floats, end: Floats, disc_px: float) -> None:
    """Draw a string of insulators: a row of discs across their axis."""
    along = end - start
    length = float(np.hypot(*along))
    along = along / max(length, 1e-9)
    across = np.array([-along[1], along[0]])
    grey, pitch = rng.uniform(25, 150), disc_px * rng.uniform(0.35, 0.7)
    rgb = np.clip(grey * np.array([1.15, 0.95, 0.9]) + rng.normal(0, 8, 3), 0, 255)
    stroke(image, np.stack([start, end]), rgb * 0.6, max(1.0, disc_px * 0.25))
    for s in np.arange(0.06 * length, 0.94 * length, max(pitch, 1.5)):
        disc = start + along * s + across * np.array([[-0.5], [0.5]]) * disc_px
        stroke(image, disc, np.clip(rgb * rng.uniform(0.8, 1.25), 0, 255), max(1.0, pitch * 0.55))


def _rings(image: ImageArray, rng: Rng, centre: Floats, disc_px: float) -> None:
    """Draw the fittings at the end of a string: grading rings and a yoke."""
    rgb = np.full(3, rng.uniform(25, 190)) + rng.normal(0, 5, 3)
    t = np.linspace(0, 2 * np.pi, 33)
    for _ in range(int(rng.integers(0, 3))):
        a, b, turn = rng.uniform(1.2, 3.2) * disc_px, rng.uniform(0.6, 1.6) * disc_px, rng.normal(0, 0.2)
        ring = np.stack([a * np.cos(t), b * np.sin(t)], 1)
        ring = ring @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        stroke(image, centre + rng.normal(0, 0.5, 2) * disc_px + ring, rgb, max(1.0, disc_px * 0.16))
    yoke = centre + rng.normal(0, 0.7, (4, 2)) * disc_px
    stroke(image, yoke, rgb * 0.8, max(1.0, disc_px * 0.35))
