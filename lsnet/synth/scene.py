"""Random cables: count, position, width and light, as seen by a camera that flies low."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from lsnet.synth.cables import Arc, Finish, draw_cable

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Image = NDArray[np.float32]
    Points = NDArray[np.float64]
    Rng = np.random.Generator

MAX_WIDTH_PX = 14.0
WIDEST_SHARE = 1 / 27  # of the side of the image, where that is less


def add_cables(image: Image, rng: Rng) -> list[Points]:
    """Draw one or two families of near-parallel cables; the centrelines of what was drawn, in pixels."""
    centrelines = _family(
        image, rng, int(rng.choice([1, 2, 3, 4, 5, 6], p=[0.2, 0.25, 0.23, 0.16, 0.1, 0.06]))
    )
    if rng.random() < 0.12:
        centrelines += _family(image, rng, int(rng.integers(1, 3)))
    return centrelines


def _family(image: Image, rng: Rng, count: int) -> list[Points]:
    height, width = image.shape[:2]
    reach = float(np.hypot(height, width))
    angle = rng.uniform(0, np.pi)
    along = np.array([np.cos(angle), np.sin(angle)])
    across = np.array([-along[1], along[0]])
    centre = np.array([rng.uniform(0, width), rng.uniform(0, height)])
    busyness = _busyness(image)
    thinnest = min(0.9 + 0.06 * busyness, 3.0)  # thinner ones are invisible in front of leaves
    widest = max(min(MAX_WIDTH_PX, WIDEST_SHARE * min(height, width)), 1.5 * thinnest)
    base_width = float(np.exp(rng.uniform(np.log(thinnest), np.log(widest))))
    spread = rng.uniform(0.05, 0.9) * reach
    offsets = np.sort(rng.uniform(-0.5, 0.5, count)) * spread
    if rng.random() < 0.25 and count > 1:  # a second cable a few widths beside its neighbour
        offsets[1] = offsets[0] + base_width * rng.uniform(1.8, 6) + rng.uniform(1, 6)
    converge = rng.normal(0, 0.06)
    sag = rng.normal(0, 0.02) * reach if rng.random() < 0.6 else 0.0
    finish, thinning = _finish(image, rng, busyness), rng.uniform(0.6, 1.0)
    centrelines = []
    for offset in offsets:
        turned = angle + converge * offset / reach * 4
        arc = _arc(centre + across * offset, turned, sag, (height, width), rng=rng)
        w = float(np.clip(base_width * rng.uniform(0.75, 1.25), thinnest, widest))
        if rng.random() < 0.15:
            finish = _finish(image, rng, busyness)
        draw_cable(image, arc, (w, w * thinning), finish, _leaves(image, rng))
        centrelines.append(arc.points(33))
    return centrelines


def _arc(through: Points, angle: float, sag: float, size: tuple[int, int], *, rng: Rng) -> Arc:
    """Return an arc through a point that crosses the image, or sometimes ends in it."""
    angle += rng.normal(0, 0.012)
    along = np.array([np.cos(angle), np.sin(angle)])
    before = after = 1.2 * float(np.hypot(*size))
    if rng.random() < 0.1:
        after = rng.uniform(0.0, 0.5) * min(size)
    start, end = through - along * before, through + along * after
    sag *= rng.uniform(0.7, 1.3)
    shift = 4 * sag * before * after / (before + after) ** 2 * np.array([-along[1], along[0]])
    start, end = start - shift, end - shift
    return Arc((start[0], start[1]), (end[0], end[1]), sag)


def _busyness(image: Image) -> float:
    """Return the mean contrast within a few pixels in grey levels: asphalt 3, sunlit leaves 25."""
    grey = image.mean(axis=2)
    return float(np.abs(grey - cv2.blur(grey, (7, 7))).mean())


def _finish(image: Image, rng: Rng, busyness: float) -> Finish:
    kinds = ["dark", "metal", "bright", "tinted", "ground", "sky"]
    kind = rng.choice(kinds, p=[0.26, 0.24, 0.16, 0.08, 0.11, 0.15])
    if kind == "sky":
        return _under_the_sky(rng)
    if kind == "dark":
        grey = rng.uniform(5, 70)
        rgb = grey + rng.normal(0, 4, 3)
    elif kind == "metal":
        rgb = rng.uniform(90, 190) + rng.normal(0, 7, 3)
    elif kind == "bright":
        rgb = rng.uniform(190, 255) + rng.normal(0, 6, 3)
    elif kind == "tinted":
        rgb = rng.uniform(20, 230, 3)
    else:  # nearly the colour of the ground
        y, x = rng.integers(image.shape[0]), rng.integers(image.shape[1])
        rgb = image[y, x] + rng.choice([-1, 1]) * (rng.uniform(18, 50) + busyness)
    rgb = np.clip(rgb, 2, 255)
    is_plain = rng.random() < (0.1 if kind == "bright" else 0.3)  # paint is flat and bright
    ambient = 1.0 if is_plain else rng.uniform(0.35, 0.8)
    return Finish(
        rgb=(float(rgb[0]), float(rgb[1]), float(rgb[2])),
        ambient=float(ambient),
        diffuse=0.0 if is_plain else float(rng.uniform(0.2, 1.1)),
        specular=0.0 if is_plain or kind == "dark" else float(max(0.0, rng.normal(0, 0.25))),
        light=float(rng.uniform(-1, 1)),
        strand_px=float(rng.uniform(5, 30)) if rng.random() < 0.5 else 0.0,
    )


def finish_for(image: Image, rng: Rng) -> Finish:
    """Return a random appearance of wires over an image."""
    return _finish(image, rng, _busyness(image))


def _under_the_sky(rng: Rng) -> Finish:
    """Return smooth grey, with one side bluish by the light of the sky and the other dark."""
    rgb = rng.uniform(90, 190) * np.array([rng.uniform(0.85, 1), 1.0, rng.uniform(1, 1.25)])
    return Finish(
        rgb=(float(rgb[0]), float(rgb[1]), float(rgb[2])),
        ambient=float(rng.uniform(0.2, 0.6)),
        diffuse=float(rng.uniform(0.5, 1.2)),
        specular=float(max(0.0, rng.normal(0, 0.2))),
        light=float(rng.choice([-1, 1]) * rng.uniform(0.2, 0.9)),
        strand_px=0.0,
    )


def _leaves(image: Image, rng: Rng) -> Image | None:
    """Return a mask of leaves that hide short stretches of a cable, or None."""
    if rng.random() > 0.12:
        return None
    height, width = image.shape[:2]
    coarse = rng.random((height // 12 + 2, width // 12 + 2), dtype=np.float32)
    noise = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    return (noise < rng.uniform(0.75, 0.95)).astype(np.float32)
