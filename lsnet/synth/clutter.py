"""What is mistaken for cables and is none: branches, trunks, kerbs, joints, fences, markings, furrows.

Each function paints one kind onto a uint8 (H, W, 3) RGB image in place; none of it is ever labelled.
Strokes are anti-aliased, which OpenCV does on integer images only: jagged edges would give clutter away.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Image = NDArray[np.uint8]
    Rng = np.random.Generator

SHIFT = 4  # fractional bits of the coordinates given to OpenCV
SCALE = 1 << SHIFT


def _stroke(image: Image, points: NDArray[np.floating], rgb: NDArray[np.floating], width_px: float) -> None:
    """One anti-aliased open polyline (K, 2)."""
    fixed = np.round((np.asarray(points) - 0.5) * SCALE).astype(np.int32)
    thickness = max(1, round(width_px))
    cv2.polylines(image, [fixed], False, rgb.tolist(), thickness, cv2.LINE_AA, SHIFT)


def _set(image: Image, values: NDArray[np.floating]) -> None:
    image[:] = np.clip(np.round(values), 0, 255)


def _direction(angle: float) -> NDArray[np.float64]:
    return np.array([np.cos(angle), np.sin(angle)])


def _anywhere(image: Image, rng: Rng, margin: float = 0.1) -> NDArray[np.float64]:
    height, width = image.shape[:2]
    return np.array([rng.uniform(-margin, 1 + margin) * width, rng.uniform(-margin, 1 + margin) * height])


def branches(image: Image, rng: Rng) -> None:
    """A bare tree: a tapering, crooked trunk that forks into twigs."""
    rgb = np.clip(rng.choice([35, 80, 120, 175]) + rng.normal(0, 12) + np.array([10, 0, -12]), 0, 255)
    straightness = rng.uniform(0.05, 0.35)
    limit = int(rng.integers(60, 260))
    stack = [
        (_anywhere(image, rng, 0.2), rng.uniform(0, 2 * np.pi), rng.uniform(50, 200), rng.uniform(2, 16))
    ]
    drawn = 0
    while stack and drawn < limit:
        start, angle, length, width = stack.pop(0)
        steps = max(3, int(length / 14))
        turns = angle + np.cumsum(rng.normal(0, straightness, steps))
        path = start + np.cumsum(np.stack([np.cos(turns), np.sin(turns)], 1) * length / steps, axis=0)
        path = np.vstack([start, path])
        tone = np.clip(rgb * rng.uniform(0.75, 1.25), 0, 255)
        half = len(path) // 2
        _stroke(image, path[: half + 1], tone, width)
        _stroke(image, path[half:], tone, width * 0.75)
        drawn += 1
        if length < 14 or width < 0.6:
            continue
        for _ in range(int(rng.integers(2, 5))):
            at = int(rng.integers(steps // 3, steps + 1))
            fork = turns[min(at, steps - 1)] + rng.choice([-1, 1]) * rng.uniform(0.25, 1.0)
            stack.append((path[at], fork, length * rng.uniform(0.45, 0.8), width * rng.uniform(0.45, 0.75)))


def shrub(image: Image, rng: Rng) -> None:
    """Long thin twigs, nearly straight, in a fan from one root, some of them forked."""
    root, heading = _anywhere(image, rng, 0.15), rng.uniform(0, 2 * np.pi)
    rgb = np.clip(rng.choice([30, 70, 110, 160, 200]) + rng.normal(0, 12) + np.array([10, 0, -12]), 0, 255)
    fan, reach, width = rng.uniform(0.15, 0.9), rng.uniform(60, 320), rng.uniform(1.2, 7)
    for _ in range(int(rng.integers(3, 28))):
        at = root + rng.normal(0, reach * 0.06, 2)
        course = (heading + rng.normal(0, fan), reach * rng.uniform(0.3, 1.0))
        tone = np.clip(rgb * rng.uniform(0.7, 1.3), 0, 255)
        _twig(image, rng, at, course, rgb=tone, width=width * rng.uniform(0.4, 1))


def _twig(
    image: Image,
    rng: Rng,
    at: NDArray[np.floating],
    course: tuple[float, float],
    *,
    rgb: NDArray[np.floating],
    width: float,
) -> None:
    """One tapering twig with its forks; `course` is its first heading and its length."""
    angle, length = course
    turns = angle + np.cumsum(rng.normal(0, rng.uniform(0.01, 0.09), 12))
    path = np.vstack([at, at + np.cumsum(np.stack([np.cos(turns), np.sin(turns)], 1) * length / 12, axis=0)])
    for part, taper in ((path[:6], 1.0), (path[5:10], 0.7), (path[9:], 0.4)):
        _stroke(image, part, rgb, width * taper)
    if length > 50:
        for _ in range(int(rng.integers(0, 4))):
            k = int(rng.integers(3, 11))
            fork = (turns[k] + rng.choice([-1, 1]) * rng.uniform(0.2, 0.9), length * 0.4)
            _twig(image, rng, path[k], fork, rgb=rgb, width=width * 0.5)


def building(image: Image, rng: Rng) -> None:
    """A box with edges: a roof with parallel ridges, or a wall with rows of openings."""
    place = _perspective(image, rng)
    a, b = rng.uniform(30, 220, 2)
    rgb = np.clip(rng.uniform(40, 230) + rng.normal(0, 15, 3), 0, 255)
    corners = place(np.array([[-a, -b], [a, -b], [a, b], [-a, b], [-a, -b]]))
    cv2.fillPoly(
        image, [np.round((corners - 0.5) * SCALE).astype(np.int32)], rgb.tolist(), cv2.LINE_AA, SHIFT
    )
    edge = np.clip(rgb * rng.choice([0.5, 1.3]), 0, 255)
    _stroke(image, corners, edge, rng.uniform(1, 7))
    if rng.random() < 0.6:
        tone = np.clip(rgb * rng.uniform(0.6, 1.3), 0, 255)
        for x in np.arange(-a, a, rng.uniform(6, 40)):
            _stroke(image, place(np.array([[x, -b], [x, b]])), tone, rng.uniform(1, 4))


def trunk(image: Image, rng: Rng) -> None:
    """A pole, pipe or trunk: a shaded band too wide for a cable."""
    start, angle = _anywhere(image, rng), rng.uniform(0, 2 * np.pi)
    width = rng.uniform(20, 60)
    end = start + _direction(angle) * rng.uniform(0.3, 2.0) * max(image.shape[:2])
    rgb = np.clip(rng.uniform(30, 220) + rng.normal(0, 12, 3), 0, 255)
    side = _direction(angle + np.pi / 2)
    light = rng.uniform(-0.8, 0.8)
    for s in np.linspace(-1, 1, 9):
        tone = rgb * (0.55 + 0.6 * max(0.0, 1 - abs(s - light)))
        offset = side * s * width / 2
        _stroke(image, np.stack([start + offset, end + offset]), np.clip(tone, 0, 255), width / 8 + 2)


def struts(image: Image, rng: Rng) -> None:
    """A piece of lattice or a cross-arm: short bars that meet at angles."""
    joints = _anywhere(image, rng, 0) + rng.normal(0, rng.uniform(25, 80), (int(rng.integers(4, 9)), 2))
    rgb = np.clip(rng.uniform(40, 235) + rng.normal(0, 8, 3), 0, 255)
    for _ in range(int(rng.integers(4, 14))):
        a, b = rng.choice(len(joints), 2, replace=False)
        _stroke(image, joints[[a, b]], np.clip(rgb * rng.uniform(0.7, 1.2), 0, 255), rng.uniform(1.5, 9))


def half_plane(image: Image, rng: Rng, ground: Image) -> None:
    """Another ground, given as an image, behind a border with or without a kerb and its shadow."""
    height, width = image.shape[:2]
    centre, angle = _anywhere(image, rng, -0.1), rng.uniform(0, 2 * np.pi)
    along, across = _direction(angle), _direction(angle + np.pi / 2)
    bend = rng.normal(0, 0.0006) if rng.random() < 0.3 else 0.0
    t = np.linspace(-1.5, 1.5, 25)[:, None] * max(height, width)
    border = centre + along * t + across * bend * t**2
    ragged = border
    if rng.random() < 0.5:  # plants that hang over the border
        steps = np.linspace(0, 24, 400)
        ragged = np.stack([np.interp(steps, np.arange(25), border[:, axis]) for axis in (0, 1)], axis=1)
        ragged = ragged + across * (rng.normal(0, 1, (400, 1)) * rng.uniform(1, 8) + rng.uniform(0, 12))
    polygon = np.vstack([ragged, (border + across * 3 * max(height, width))[::-1]])
    mask = np.zeros((height, width), np.uint8)
    cv2.fillPoly(mask, [np.round(polygon * SCALE).astype(np.int32)], 255, cv2.LINE_AA, SHIFT)
    if rng.random() < 0.8:
        _kerb(image, rng, border, across if rng.random() < 0.5 else -across)
    alpha = (mask.astype(np.float32) / 255)[..., None]
    if rng.random() < 0.4:  # and the shadow they throw
        shade = cv2.GaussianBlur(alpha, (0, 0), rng.uniform(1, 8))[..., None]
        _set(image, image * (1 - np.float32(rng.uniform(0.2, 0.7)) * shade))
    _set(image, image + alpha * (ground - image.astype(np.float32)))


def _kerb(image: Image, rng: Rng, border: NDArray[np.floating], across: NDArray[np.floating]) -> None:
    """Bands of different tones beside each other along a border, worn and soft, with joints now and then."""
    kerb_width, tone = rng.uniform(2, 26), rng.uniform(40, 245)
    layer = image.copy()
    at = 0.0
    for _ in range(int(rng.integers(1, 5))):
        band = max(1.0, kerb_width * rng.uniform(0.1, 1.0))
        rgb = np.clip(np.full(3, tone * rng.uniform(0.25, 1.1)) + rng.normal(0, 5, 3), 0, 255)
        _stroke(layer, border + across * (at + band / 2), rgb, band + 1)
        at += band
    if rng.random() < 0.4:
        _ties(layer, rng, border, across * at, tone * 0.5)
    soft = cv2.GaussianBlur(layer, (0, 0), rng.uniform(0.3, 2.2)) if rng.random() < 0.7 else layer
    height, width = image.shape[:2]
    coarse = rng.uniform(rng.uniform(0, 1), 1, (height // 24 + 2, width // 24 + 2)).astype(np.float32)
    worn = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_LINEAR)[..., None]
    _set(image, image + worn * (soft.astype(np.float32) - image.astype(np.float32)))


def _ties(
    image: Image, rng: Rng, border: NDArray[np.floating], reach: NDArray[np.floating], tone: float
) -> None:
    """Short joints across a band along `border`."""
    steps = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(border, axis=0).T))])
    for s in np.arange(0, steps[-1], rng.uniform(12, 60)):
        at = np.array([np.interp(s, steps, border[:, 0]), np.interp(s, steps, border[:, 1])])
        _stroke(image, np.stack([at - reach * 0.5, at + reach]), np.full(3, tone), 1)


def tile_grid(image: Image, rng: Rng) -> None:
    """Paving, bricks, concrete slabs or roof sheets: joints in two directions over a patch."""
    height, width = image.shape[:2]
    step = np.array([rng.uniform(7, 160), rng.uniform(7, 160)])
    half = rng.uniform(0.25, 1.6) * max(height, width) / 2
    counts = np.minimum(2 * half / step, 60).astype(int) + 1
    is_bond = rng.random() < 0.4
    layer = image.copy()
    base = float(image.mean())
    rgb = np.clip(np.full(3, base + rng.choice([-1, 1]) * rng.uniform(15, 90)) + rng.normal(0, 5, 3), 0, 255)
    joint = rng.uniform(1, 3.4)
    place = _perspective(image, rng)
    for i in range(counts[0]):
        x = -half + i * step[0]
        if not is_bond:
            _stroke(layer, place(np.array([[x, -half], [x, half]])), rgb, joint)
            continue
        for j in range(counts[1]):
            shifted = x + (j % 2) * step[0] / 2
            y = -half + j * step[1]
            _stroke(layer, place(np.array([[shifted, y], [shifted, y + step[1]]])), rgb, joint)
    for j in range(counts[1]):
        y = -half + j * step[1]
        _stroke(layer, place(np.array([[-half, y], [half, y]])), rgb, joint)
    opacity = rng.uniform(0.35, 1.0)
    cv2.addWeighted(layer, opacity, image, 1 - opacity, 0, dst=image)


def _perspective(image: Image, rng: Rng) -> Callable[[NDArray[np.floating]], NDArray[np.float64]]:
    """A random plane-to-image map: turned, placed anywhere, slightly foreshortened."""
    angle, centre = rng.uniform(0, 2 * np.pi), _anywhere(image, rng, 0)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    squeeze = np.array([1.0, rng.uniform(0.4, 1.0)])
    vanish = rng.normal(0, 0.0004, 2)

    def place(points: NDArray[np.floating]) -> NDArray[np.float64]:
        depth = np.maximum(1 + points @ vanish, 0.2)[:, None]
        out: NDArray[np.float64] = (points / depth * squeeze) @ turn.T + centre
        return out

    return place


def fence(image: Image, rng: Rng) -> None:
    """Rails on posts, or a ladder of crossings: parallel lines joined by many short ones."""
    place = _perspective(image, rng)
    half, gap = rng.uniform(0.3, 1.2) * max(image.shape[:2]), rng.uniform(6, 40)
    rgb = np.clip(rng.uniform(20, 240) + rng.normal(0, 10, 3), 0, 255)
    rails, width = int(rng.integers(2, 5)), rng.uniform(1, 4)
    for k in range(rails):
        _stroke(image, place(np.array([[-half, k * gap], [half, k * gap]])), rgb, width)
    for x in np.arange(-half, half, rng.uniform(5, 40)):
        post = np.array([[x, -gap * 0.3], [x, (rails - 1) * gap + gap * 0.3]])
        _stroke(image, place(post), rgb, width * rng.uniform(0.8, 1.6))


def markings(image: Image, rng: Rng) -> None:
    """Road paint: wide stripes, dashes, rows of parking bays."""
    place = _perspective(image, rng)
    rgb = np.array([235, 235, 230]) if rng.random() < 0.7 else np.array([225, 175, 60])
    rgb = np.clip(rgb * rng.uniform(0.6, 1.05) + rng.normal(0, 5, 3), 0, 255)
    reach = float(max(image.shape[:2]))
    kind = rng.integers(3)
    if kind == 0:  # a stripe wider than any cable
        _stroke(image, place(np.array([[-reach, 0], [reach, 0]])), rgb, rng.uniform(17, 45))
    elif kind == 1:  # dashes
        dash, width = rng.uniform(15, 90), rng.uniform(3, 20)
        for x in np.arange(-reach, reach, dash * rng.uniform(1.6, 3)):
            _stroke(image, place(np.array([[x, 0], [x + dash, 0]])), rgb, width)
    else:  # bays
        step, depth, width = rng.uniform(20, 90), rng.uniform(30, 140), rng.uniform(2, 12)
        for x in np.arange(-reach, reach, step):
            _stroke(image, place(np.array([[x, 0], [x + depth * 0.3, depth]])), rgb, width)


def furrows(image: Image, rng: Rng) -> None:
    """A field of soft parallel rows, bent and uneven."""
    height, width = image.shape[:2]
    angle, period = rng.uniform(0, np.pi), rng.uniform(6, 60)
    x, y = np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32)[:, None]
    wave = cv2.resize(
        rng.normal(0, 1, (5, 5)).astype(np.float32), (width, height), interpolation=cv2.INTER_CUBIC
    )
    phase = (x * np.cos(angle) + y * np.sin(angle)) * (2 * np.pi / period) + wave * rng.uniform(0, 2.5)
    rows = np.sin(phase).astype(np.float32)
    if rng.random() < 0.5:
        rows = np.sign(rows) * np.abs(rows) ** np.float32(0.4)
    _set(image, image + (rows * np.float32(rng.uniform(6, 40)))[..., None])


def cracks(image: Image, rng: Rng) -> None:
    """Crooked thin lines: cracks, paths, vines, edges of shadows."""
    for _ in range(int(rng.integers(1, 6))):
        steps, step = int(rng.integers(8, 40)), rng.uniform(6, 18)
        turns = rng.uniform(0, 2 * np.pi) + np.cumsum(rng.normal(0, rng.uniform(0.2, 0.6), steps))
        path = _anywhere(image, rng) + np.cumsum(np.stack([np.cos(turns), np.sin(turns)], 1) * step, axis=0)
        _stroke(image, path, np.clip(rng.uniform(0, 255) + rng.normal(0, 10, 3), 0, 255), rng.uniform(1, 4))


def foliage(image: Image, rng: Rng) -> None:
    """Leaves: many small blobs of one hue, lit and in shade, over a patch or all over."""
    height, width = image.shape[:2]
    is_dense = rng.random() < 0.45
    count, size = 2500 if is_dense else int(rng.integers(150, 900)), rng.uniform(1.5, 6)
    hue = np.array([rng.uniform(50, 150), rng.uniform(60, 160), rng.uniform(20, 90)])
    centre, spread = _anywhere(image, rng, 0), rng.uniform(0.15, 0.8) * max(height, width)
    places = centre + rng.normal(0, spread / 2, (count, 2))
    if is_dense:
        places = rng.uniform(-5, 5, (count, 2)) + rng.uniform(0, 1, (count, 2)) * [width, height]
    tones = np.clip(hue * rng.gamma(rng.uniform(1.5, 4), 0.3, (count, 1)), 0, 255)
    axes, angles = rng.uniform(0.4, 1.6, (count, 2)) * size, rng.uniform(0, 180, count)
    for place, tone, axis, angle in zip(places, tones, axes, angles, strict=True):
        centre_fixed = (int(place[0] * SCALE), int(place[1] * SCALE))
        axes_fixed = (int(axis[0] * SCALE), int(axis[1] * SCALE))
        cv2.ellipse(image, centre_fixed, axes_fixed, angle, 0, 360, tone.tolist(), -1, cv2.LINE_AA, SHIFT)


# In the order of painting, from the ground up; how likely each kind is to be painted (again).
KINDS: dict[Callable[[Image, Rng], None], float] = {
    furrows: 0.08,
    markings: 0.14,
    tile_grid: 0.18,
    cracks: 0.10,
    building: 0.12,
    foliage: 0.22,
    fence: 0.08,
    trunk: 0.12,
    struts: 0.10,
    branches: 0.25,
    shrub: 0.42,
}
BORDER_PROBABILITY = 0.5  # of another ground, again and again


def add_clutter(image: Image, rng: Rng, ground: Callable[[], Image]) -> None:
    """Paint each kind none, one or several times; `ground` gives other backgrounds of the same size."""
    while rng.random() < BORDER_PROBABILITY:
        half_plane(image, rng, ground())
    for paint, probability in KINDS.items():
        while rng.random() < probability:
            paint(image, rng)
