"""Borders between two grounds: kerbs, gutters, road sides, edgings, overhanging plants."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from lsnet.synth.brush import MIN_DETAILED_PX, SCALE, SHIFT, anywhere, direction, put, smooth_noise, stroke

if TYPE_CHECKING:
    from lsnet.arrays import Floats, Floats32, ImageArray, RealArray, Rng


def half_plane(image: ImageArray, rng: Rng, ground: ImageArray) -> None:
    """Draw another ground, given as an image, behind a border with or without a kerb and its shadow."""
    height, width = image.shape[:2]
    centre, angle = anywhere(image, rng, -0.1), rng.uniform(0, 2 * np.pi)
    along, across = direction(angle), direction(angle + np.pi / 2)
    bend = rng.normal(0, 0.0006) if rng.random() < 0.3 else 0.0
    t = np.linspace(-1.5, 1.5, 25)[:, None] * max(height, width)
    border = centre + along * t + across * bend * t**2
    ragged = border
    if rng.random() < 0.5:  # plants overhang the border
        steps = np.linspace(0, 24, 400)
        ragged = np.stack([np.interp(steps, np.arange(25), border[:, axis]) for axis in (0, 1)], axis=1)
        ragged = ragged + across * (rng.normal(0, 1, (400, 1)) * rng.uniform(1, 8) + rng.uniform(0, 12))
    polygon = np.vstack([ragged, (border + across * 3 * max(height, width))[::-1]])
    mask = np.zeros((height, width), np.uint8)
    cv2.fillPoly(mask, [np.round(polygon * SCALE).astype(np.int32)], 255, cv2.LINE_AA, SHIFT)
    if rng.random() < 0.8:
        _kerb(image, rng, border, across if rng.random() < 0.5 else -across)
    alpha = (mask.astype(np.float32) / 255)[..., None]
    if rng.random() < 0.4:  # and cast a shadow
        shade = cv2.GaussianBlur(alpha, (0, 0), rng.uniform(1, 8))[..., None]
        put(image, image * (1 - np.float32(rng.uniform(0.2, 0.7)) * shade))
    put(image, image + alpha * (ground - image.astype(np.float32)))


def _kerb(image: ImageArray, rng: Rng, border: RealArray, across: RealArray) -> None:
    """Draw bands of different tones along a border, worn and soft, some with joints."""
    kerb_width, tone = rng.uniform(2, 26), rng.uniform(40, 245)
    layer = image.copy()
    at = 0.0
    for _ in range(int(rng.integers(1, 5))):
        band = max(1.0, kerb_width * rng.uniform(0.1, 1.0))
        rgb = np.clip(np.full(3, tone * rng.uniform(0.25, 1.1)) + rng.normal(0, 5, 3), 0, 255)
        stroke(layer, border + across * (at + band / 2), rgb, band + 1)
        at += band
    if rng.random() < 0.4:
        _ties(layer, rng, border, across * at, tone * 0.5)
    soft = cv2.GaussianBlur(layer, (0, 0), rng.uniform(0.3, 2.2)) if rng.random() < 0.7 else layer
    height, width = image.shape[:2]
    coarse = rng.uniform(rng.uniform(0, 1), 1, (height // 24 + 2, width // 24 + 2)).astype(np.float32)
    worn = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_LINEAR)[..., None]
    put(image, image + worn * (soft.astype(np.float32) - image.astype(np.float32)))


def _ties(image: ImageArray, rng: Rng, border: RealArray, reach: RealArray, tone: float) -> None:
    """Draw short joints across a band along `border`."""
    steps = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(border, axis=0).T))])
    for s in np.arange(0, steps[-1], rng.uniform(12, 60)):
        at = np.array([np.interp(s, steps, border[:, 0]), np.interp(s, steps, border[:, 1])])
        stroke(image, np.stack([at - reach * 0.5, at + reach]), np.full(3, tone), 1)


def roadside(image: ImageArray, rng: Rng) -> None:
    """Draw the straight edge of a road, a roof or a wall: bands of similar tones between two grounds.

    One side is smooth paving, the other the existing ground. Gutter, kerb and shadow between them are as
    thin, straight and even as cables, but never have the same ground on both sides.
    """
    height, width = image.shape[:2]
    angle, through = rng.uniform(0, 2 * np.pi), anywhere(image, rng, -0.1)
    across = direction(angle + np.pi / 2)
    x, y = np.arange(width, dtype=np.float32) + 0.5, (np.arange(height, dtype=np.float32) + 0.5)[:, None]
    v = ((x - through[0]) * across[0] + (y - through[1]) * across[1]).astype(np.float32)
    if rng.random() < 0.3:
        u = (x - through[0]) * across[1] - (y - through[1]) * across[0]
        v += np.float32(rng.normal(0, 0.0006)) * u * u
    widths, tones = _bands(rng)
    edges = np.concatenate([[0.0], np.cumsum(widths)])
    v += smooth_noise(rng, (height, width), rng.uniform(8, 60)) * np.float32(rng.uniform(0, 0.7))
    fine = np.arange(-8, edges[-1] + 8, 0.25)
    band = np.clip(np.searchsorted(edges, fine, side="right"), 0, len(tones) - 1)
    profile = cv2.GaussianBlur(tones[band][None], (0, 0), rng.uniform(1, 6)).ravel()
    tone = np.interp(v, fine, profile).astype(np.float32)
    paving = tones[0] + (tone - tones[0]) * (
        1 - np.float32(rng.uniform(0, 0.6)) * np.abs(smooth_noise(rng, (height, width), 30))
    )
    tint = 1 + rng.normal(0, 0.03, 3).astype(np.float32)
    road = paving[..., None] * tint + smooth_noise(rng, (height, width), 1)[..., None] * rng.uniform(0, 7)
    road += smooth_noise(rng, (height, width), rng.uniform(20, 150))[..., None] * rng.uniform(0, 10)
    if rng.random() < 0.5:
        road = _painted(road, v, rng)
    ragged = smooth_noise(rng, (height, width), rng.uniform(2, 10)) * np.float32(rng.uniform(0, 4))
    alpha = np.clip(edges[-1] + 0.5 - (v + (ragged if rng.random() < 0.5 else 0)), 0, 1)[..., None]
    if rng.random() < 0.3:  # a strip too wide for a cable
        alpha *= np.clip(v + 0.5 + rng.uniform(25, 90), 0, 1)[..., None]
    put(image, image + alpha * (road - image.astype(np.float32)))


def _painted(road: RealArray, v: RealArray, rng: Rng) -> RealArray:
    """Draw painted lines along the road side; v (H, W) is the distance from it, px.

    As wide as cables and as straight, but flat in tone, and worn: the grain of the paving shows through.
    """
    white, yellow = np.array([235.0, 235, 228]), np.array([215.0, 160, 50])
    for _ in range(int(rng.integers(1, 4))):
        rgb = (white if rng.random() < 0.6 else yellow) * rng.uniform(0.5, 1.05)
        width, at = rng.uniform(1.5, 14), -rng.uniform(5, 250)
        worn = np.clip(rng.uniform(0.6, 1.1) + smooth_noise(rng, v.shape, 1) * rng.uniform(0, 0.15), 0, 1)
        worn = worn * np.clip(rng.uniform(0.8, 1.6) + 0.4 * smooth_noise(rng, v.shape, 12), 0, 1)
        places = (at, at - width * rng.uniform(1.7, 3)) if rng.random() < 0.35 else (at,)  # double lines
        for place in places:
            alpha = (np.clip(width / 2 + 0.5 - np.abs(v - place), 0, 1) * worn)[..., None]
            road = road + alpha * (rgb - road)
    return road


def _bands(rng: Rng) -> tuple[Floats, Floats32]:
    """Return widths in pixels of gutter, kerb faces and shadows, and the tones, beginning with the paving."""
    base, count = rng.uniform(30, 215), int(rng.integers(1, 6))
    widths = np.where(rng.random(count) < 0.55, rng.uniform(1, 5, count), rng.uniform(4, 18, count))
    contrast = rng.uniform(0.08, 0.6)
    tones = base * np.exp(rng.normal(0, contrast, count + 1))
    tones[0] = base
    return widths, np.clip(tones, 3, 250).astype(np.float32)


def edging(image: ImageArray, rng: Rng) -> None:
    """Draw plastic edging, a silt fence, boards or an open joint: long, thin, ragged, partly hidden.

    The same ground lies on both sides; it may bend where it is staked. None in small pictures, in which
    it cannot be distinguished from a wire.
    """
    height, width = image.shape[:2]
    if min(height, width) < MIN_DETAILED_PX:
        return
    angle, through = rng.uniform(0, 2 * np.pi), anywhere(image, rng, -0.1)
    across = direction(angle + np.pi / 2)
    x, y = np.arange(width, dtype=np.float32) + 0.5, (np.arange(height, dtype=np.float32) + 0.5)[:, None]
    v = ((x - through[0]) * across[0] + (y - through[1]) * across[1]).astype(np.float32)
    u = ((x - through[0]) * across[1] - (y - through[1]) * across[0]).astype(np.float32)
    bend = np.float32(rng.uniform(-0.25, 0.25) if rng.random() < 0.4 else 0.0)
    v += bend * np.maximum(u - np.float32(rng.uniform(-0.4, 0.4) * width), 0)
    v += smooth_noise(rng, (height, width), rng.uniform(20, 80)) * np.float32(rng.uniform(0, 1.2))
    ragged = smooth_noise(rng, (height, width), rng.uniform(1.5, 5)) * np.float32(rng.uniform(0.6, 2.0))
    half = np.float32(rng.uniform(0.8, 4.5))
    alpha = np.clip(half + 0.5 + ragged - np.abs(v), 0, 1) * np.float32(rng.uniform(0.5, 1))
    hidden = rng.uniform(0.5, 3) + smooth_noise(rng, (height, width), rng.uniform(6, 40))
    alpha *= np.clip(hidden, 0, 1)
    tone = image.mean() * (rng.uniform(0.05, 0.6) if rng.random() < 0.7 else rng.uniform(1.2, 2.5))
    rgb = np.clip(tone * (1 + rng.normal(0, 0.06, 3)), 2, 245).astype(np.float32)
    grained = rgb + smooth_noise(rng, (height, width), 1.2)[..., None] * np.float32(rng.uniform(0, 12))
    put(image, image + alpha[..., None] * (grained - image))


def road_bend(image: ImageArray, rng: Rng) -> None:
    """Draw lines along the bend of a road or a path: paint, a seam of tarmac, or a worn edge.

    The same ground lies on both sides, but no wire bends as much. None in small pictures.
    """
    height, width = image.shape[:2]
    if min(height, width) < MIN_DETAILED_PX:
        return
    length = np.exp(rng.uniform(np.log(0.3), np.log(2))) * max(height, width)
    t = np.linspace(-0.5, 0.5, 65)
    turn, sway = rng.choice([-1, 1]) * rng.uniform(0.35, 2.2), rng.normal(0, 1.5)
    angles = rng.uniform(0, 2 * np.pi) + turn * t + sway * t**2 * rng.random()
    steps = np.stack([np.cos(angles), np.sin(angles)], axis=1) * length / len(t)
    middle = np.cumsum(steps, axis=0)
    middle += anywhere(image, rng) - middle[32]
    across = np.stack([-steps[:, 1], steps[:, 0]], axis=1) / np.hypot(*steps.T)[:, None]
    layer, tone = image.copy(), float(image.mean())
    for _ in range(int(rng.integers(1, 4))):
        is_paint = rng.random() < 0.5
        paint = np.array([235.0, 235, 228]) if rng.random() < 0.5 else np.array([215.0, 165, 60])
        seam = np.full(3, tone * (rng.uniform(0.2, 0.8) if rng.random() < 0.6 else rng.uniform(1.2, 1.8)))
        rgb = np.clip((paint * rng.uniform(0.6, 1) if is_paint else seam) + rng.normal(0, 4, 3), 2, 250)
        at, width_px = rng.uniform(-0.08, 0.08) * max(height, width), rng.uniform(1, 7 if is_paint else 4)
        for shift in (0.0, width_px * rng.uniform(1.8, 3)) if rng.random() < 0.3 else (0.0,):
            stroke(layer, middle + across * (at + shift), rgb, width_px)
    soft = cv2.GaussianBlur(layer, (0, 0), rng.uniform(0.4, 1.4)).astype(np.float32)
    worn = np.clip(rng.uniform(0.4, 1.4) + 0.4 * smooth_noise(rng, (height, width), 9), 0, 1)[..., None]
    put(image, image + worn * (soft - image))
