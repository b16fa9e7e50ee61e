"""Man-made straight lines seen from above: tops of walls, painted lines of yards, roof edges, boulevards.

Each is as long, thin and straight as a wire, and most have the same ground on both sides. They differ by what
goes with them: a lit top has a dark face and a shadow, paint is flat, worn and ruled by right angles, an edge
goes around a roof, kerbs come with a road.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import cv2
import numpy as np

from lsnet.synth.brush import (
    MIN_DETAILED_PX,
    SCALE,
    SHIFT,
    anywhere,
    direction,
    perspective,
    put,
    smooth_noise,
    stroke,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from lsnet.arrays import Floats, ImageArray, RealArray, Rng

    Place = Callable[[RealArray], Floats]

PAINTS = np.array([[235.0, 235, 228], [215, 165, 60], [190, 60, 50], [60, 90, 170]])
PAINT_SHARES = (0.62, 0.26, 0.07, 0.05)


def wall(image: ImageArray, rng: Rng) -> None:
    """Draw a wall from above: its lit top, one face, its shadow, and joints of the coping; some turn."""
    if min(image.shape[:2]) < MIN_DETAILED_PX:
        return
    reach, width = max(image.shape[:2]), float(np.exp(rng.uniform(np.log(2.5), np.log(18))))
    path = np.array([[0.0, 0.0], [rng.uniform(0.2, 2.0) * reach, 0.0]])
    while rng.random() < 0.3:
        step = rng.uniform(0.05, 0.7) * reach * rng.choice([-1, 1])
        path = np.vstack([path, path[-1] + (step, 0) if len(path) % 2 else path[-1] + (0, step)])
    path = perspective(image, rng)(path - path.mean(axis=0))
    rgb = np.clip(rng.uniform(70, 245) * (1 + rng.normal(0, 0.05, 3)), 5, 250)
    down = direction(rng.uniform(0, 2 * np.pi))  # in which the wall leans away from the middle of the picture
    face_px = width * rng.uniform(0.0, 2.5)
    _shade(image, path + down * face_px * rng.uniform(0.5, 3), rng, face_px + width)
    layer = image.copy()
    if face_px > 1:
        stroke(layer, path + down * (width + face_px) / 2, rgb * rng.uniform(0.3, 0.85), face_px + 1)
    stroke(layer, path, rgb, width)
    if width > 4 and rng.random() < 0.4:  # the edges of the coping
        for side in (-0.5, 0.5):
            stroke(layer, path + down * side * width, np.clip(rgb * rng.uniform(0.5, 1.3), 0, 255), 1)
    if rng.random() < 0.4:
        _joints(layer, path, rng, width, rgb * 0.6)
    _lay(image, layer, rng)


def _shade(image: ImageArray, path: RealArray, rng: Rng, width_px: float) -> None:
    """Darken a soft band along a path."""
    shade = np.zeros(image.shape[:2], np.uint8)
    fixed = np.round((path - 0.5) * SCALE).astype(np.int32)
    cv2.polylines(shade, [fixed], False, 255, max(1, round(width_px)), cv2.LINE_AA, SHIFT)
    soft = cv2.GaussianBlur(shade, (0, 0), rng.uniform(0.6, 3)).astype(np.float32)
    put(image, image * (1 - np.float32(rng.uniform(0, 0.6) / 255) * soft[..., None]))


def _joints(image: ImageArray, path: RealArray, rng: Rng, width_px: float, rgb: RealArray) -> None:
    """Draw short joints across a path."""
    pitch_px = rng.uniform(3, 14) * width_px
    for start, end in pairwise(path):
        length = float(np.hypot(*(end - start)))
        along = (end - start) / max(length, 1e-9)
        across = np.array([-along[1], along[0]]) * width_px / 2
        for s in np.arange(pitch_px, length, pitch_px):
            stroke(image, start + along * s + np.stack([-across, across]), rgb, 1)


def _lay(image: ImageArray, layer: ImageArray, rng: Rng, *, is_paint: bool = False) -> None:
    """Replace an image by a layer, softened, with grain; paint is worn, so the ground shows through."""
    size = layer.shape[:2]
    soft = cv2.GaussianBlur(layer, (0, 0), rng.uniform(0.3, 1.3)).astype(np.float32)
    grain = smooth_noise(rng, size, rng.uniform(1, 3)) * np.float32(rng.uniform(0, 7))
    is_new = (soft != image).any(axis=2)
    soft += (grain * is_new)[..., None]
    opacity = np.float32(rng.uniform(0.75, 1.0))
    if is_paint:
        worn = rng.uniform(0.3, 1.5) + rng.uniform(0.05, 0.5) * smooth_noise(rng, size, rng.uniform(2, 20))
        opacity = np.clip(worn, 0, 1)[..., None].astype(np.float32)
    put(image, image + opacity * (soft - image))


def painted_lines(image: ImageArray, rng: Rng) -> None:
    """Draw painted lines of a yard or a car park: single, parallel or crossed ones, dashes, bays, boxes."""
    if min(image.shape[:2]) < MIN_DETAILED_PX:
        return
    place, reach = perspective(image, rng), float(max(image.shape[:2]))
    rgb = PAINTS[rng.choice(len(PAINTS), p=PAINT_SHARES)] * rng.uniform(0.55, 1.0)
    rgb = np.clip(rgb + rng.normal(0, 5, 3), 2, 250)
    width = float(np.exp(rng.uniform(np.log(2.0), np.log(14))))  # thinner paint looks like a wire
    layer, layout = image.copy(), int(rng.choice(4, p=(0.4, 0.2, 0.25, 0.15)))
    for line in (_ruled, _dashes, _bays, _box)[layout](rng, reach, width):
        stroke(layer, place(np.linspace(line[0], line[-1], 9) if len(line) == 2 else line), rgb, width)
    _lay(image, layer, rng, is_paint=True)


def _ruled(rng: Rng, reach: float, width: float) -> Sequence[RealArray]:
    """Straight lines across the yard, parallel or at right angles, some of which end there."""
    lines, at = [], 0.0
    for _ in range(int(rng.integers(1, 5))):
        begin, end = np.sort(rng.uniform(-1.2, 1.2, 2)) * reach
        lines.append(np.array([[begin, at], [end, at]]))
        at += width * rng.uniform(1.8, 5) if rng.random() < 0.3 else rng.uniform(15, 200)
    if rng.random() < 0.4:
        x = rng.uniform(-0.5, 0.5) * reach
        lines.append(np.array([[x, -rng.uniform(0.1, 1) * reach], [x, rng.uniform(0, 1) * reach]]))
    return lines


def _dashes(rng: Rng, reach: float, width: float) -> Sequence[RealArray]:
    """One or two rows of dashes, and a full line beside them."""
    dash = rng.uniform(4, 20) * width
    starts = np.arange(-reach, reach, dash * rng.uniform(1.2, 3))
    rows = [0.0] + [rng.uniform(20, 200)] * (rng.random() < 0.4)
    lines = [np.array([[x, y], [x + dash, y]]) for y in rows for x in starts]
    if rng.random() < 0.4:
        y = width * rng.uniform(2, 4)
        lines.append(np.array([[-reach, y], [reach, y]]))
    return lines


def _bays(rng: Rng, reach: float, width: float) -> Sequence[RealArray]:
    """Bays of parked cars on one or both sides of a long line."""
    step, depth, slant = max(rng.uniform(15, 110), 3 * width), rng.uniform(30, 220), rng.normal(0, 0.3)
    sides = (-1, 1) if rng.random() < 0.5 else (1,)
    begin, end = np.sort(rng.uniform(-1, 1, 2)) * reach
    bars = np.arange(begin, end, step)
    lines = [np.array([[x, 0], [x + slant * depth, side * depth]]) for x in bars for side in sides]
    return [*lines, np.array([[begin, 0], [end, 0]])] if rng.random() < 0.7 else lines


def _box(rng: Rng, reach: float, _width: float) -> Sequence[RealArray]:
    """A rectangle, some with hatching."""
    a, b = rng.uniform(0.05, 0.6, 2) * reach
    lines = [np.array([[-a, -b], [a, -b], [a, b], [-a, b], [-a, -b]])]
    if rng.random() < 0.5:
        steps = np.arange(-a, a - min(b, a), rng.uniform(15, 80))
        lines += [np.array([[x, -b], [x + min(2 * b, a), -b + min(2 * b, a)]]) for x in steps]
    return lines


def roof(image: ImageArray, rng: Rng) -> None:
    """Draw a flat or ridged roof with a parapet or gutter around it, and its shadow on the ground."""
    if min(image.shape[:2]) < MIN_DETAILED_PX:
        return
    a, b = rng.uniform(0.08, 0.7, 2) * max(image.shape[:2])
    place = perspective(image, rng)
    corners = place(np.array([[-a, -b], [a, -b], [a, b], [-a, b], [-a, -b]]))
    _shade(image, corners + rng.normal(0, 8, 2), rng, rng.uniform(2, 16))
    rgb = np.clip(rng.uniform(40, 220) * (1 + rng.normal(0, 0.1, 3)), 5, 250)
    layer, edge_px = image.copy(), float(np.exp(rng.uniform(np.log(1.5), np.log(14))))
    if rng.random() < 0.7:  # else its own photograph, as a terrace
        fixed = np.round((corners - 0.5) * SCALE).astype(np.int32)
        cv2.fillPoly(layer, [fixed], rgb.tolist(), cv2.LINE_AA, SHIFT)
    if rng.random() < 0.5:
        for x in np.arange(-a, a, rng.uniform(8, 60)):
            stroke(
                layer, place(np.array([[x, -b], [x, b]])), np.clip(rgb * rng.uniform(0.8, 1.15), 0, 255), 1
            )
    if rng.random() < 0.5:
        stroke(
            layer, place(np.array([[-a, 0], [a, 0]])), np.clip(rgb * rng.uniform(0.6, 1.4), 0, 255), edge_px
        )
    inner = corners + direction(rng.uniform(0, 2 * np.pi)) * edge_px * 0.8
    stroke(layer, inner, rgb * rng.uniform(0.3, 0.8), max(1.0, edge_px * rng.uniform(0.3, 1)))
    stroke(layer, corners, np.clip(rgb * rng.uniform(0.8, 1.7), 0, 252), edge_px)
    _lay(image, layer, rng)


def boulevard(image: ImageArray, rng: Rng) -> None:
    """Draw carriageways between kerbs with a strip between them, lane lines, and trees that hide parts."""
    height, width = image.shape[:2]
    if min(height, width) < MIN_DETAILED_PX:
        return
    through, across = anywhere(image, rng, 0.1), direction(rng.uniform(0, 2 * np.pi))
    x, y = np.arange(width, dtype=np.float32) + 0.5, (np.arange(height, dtype=np.float32) + 0.5)[:, None]
    v = ((x - through[0]) * across[0] + (y - through[1]) * across[1]).astype(np.float32)
    widths, tones = _carriageways(rng, 0.25 * max(height, width))
    edges = np.concatenate([[0.0], np.cumsum(widths)])
    edges -= edges[-1] / 2
    fine = np.arange(edges[0] - 8, edges[-1] + 8, 0.25)
    band = np.clip(np.searchsorted(edges, fine, side="right") - 1, 0, len(tones) - 1)
    profile = cv2.GaussianBlur(tones[band][None], (0, 0), rng.uniform(1, 6)).ravel()
    v += smooth_noise(rng, (height, width), rng.uniform(8, 60)) * np.float32(rng.uniform(0, 0.6))
    road = np.interp(v, fine, profile)[..., None] * (1 + rng.normal(0, 0.03, 3))
    road += smooth_noise(rng, (height, width), 1)[..., None] * rng.uniform(0, 7)
    road += smooth_noise(rng, (height, width), rng.uniform(20, 150))[..., None] * rng.uniform(0, 10)
    shown = np.clip(edges[-1] + 0.5 - np.abs(v), 0, 1)
    if rng.random() < 0.6:  # trees
        crowns = smooth_noise(rng, (height, width), rng.uniform(15, 70)) + rng.uniform(0, 2)
        shown *= np.clip(4 * crowns, 0, 1)
    put(image, image + shown[..., None] * (road - image))


def _carriageways(rng: Rng, lane_px: float) -> tuple[Floats, RealArray]:
    """Return widths in pixels and tones of kerbs, carriageways with lane lines, and the strip between."""
    asphalt, kerb, strip = rng.uniform(50, 150), rng.uniform(90, 235), rng.uniform(50, 200)
    paint, kerb_px = rng.uniform(150, 245), float(np.exp(rng.uniform(np.log(1.2), np.log(9))))
    lane_px = rng.uniform(0.2, 1.0) * lane_px
    one = [(kerb_px, kerb), (lane_px, asphalt)]
    for _ in range(int(rng.integers(0, 3))):
        one += [(rng.uniform(1, 6), paint), (lane_px, asphalt)]
    one += [(rng.uniform(1, 4), asphalt * 0.6)] * (rng.random() < 0.5) + [(kerb_px, kerb)]
    both = one if rng.random() < 0.4 else [*one, (rng.uniform(0.1, 1) * lane_px, strip), *one[::-1]]
    widths, tones = np.array(both).T
    return widths, tones.astype(np.float32)
