"""Man-made structures: roofs, lattices, paving, fences, road paint, furrows, shadows of wires."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from lsnet.synth.brush import MIN_DETAILED_PX, SCALE, SHIFT, anywhere, direction, perspective, put, stroke

if TYPE_CHECKING:
    from lsnet.arrays import ImageArray, Rng


def building(image: ImageArray, rng: Rng) -> None:
    """Draw a box with edges: a roof with parallel ridges, or a wall with rows of openings."""
    place = perspective(image, rng)
    a, b = rng.uniform(30, 220, 2)
    rgb = np.clip(rng.uniform(40, 230) + rng.normal(0, 15, 3), 0, 255)
    corners = place(np.array([[-a, -b], [a, -b], [a, b], [-a, b], [-a, -b]]))
    cv2.fillPoly(
        image, [np.round((corners - 0.5) * SCALE).astype(np.int32)], rgb.tolist(), cv2.LINE_AA, SHIFT
    )
    edge = np.clip(rgb * rng.choice([0.5, 1.3]), 0, 255)
    stroke(image, corners, edge, rng.uniform(1, 7))
    if rng.random() < 0.6:
        tone = np.clip(rgb * rng.uniform(0.6, 1.3), 0, 255)
        for x in np.arange(-a, a, rng.uniform(6, 40)):
            stroke(image, place(np.array([[x, -b], [x, b]])), tone, rng.uniform(1, 4))


def struts(image: ImageArray, rng: Rng) -> None:
    """Draw a piece of lattice or a cross-arm: short bars that meet at angles."""
    joints = anywhere(image, rng, 0) + rng.normal(0, rng.uniform(25, 80), (int(rng.integers(4, 9)), 2))
    rgb = np.clip(rng.uniform(40, 235) + rng.normal(0, 8, 3), 0, 255)
    for _ in range(int(rng.integers(4, 14))):
        a, b = rng.choice(len(joints), 2, replace=False)
        stroke(image, joints[[a, b]], np.clip(rgb * rng.uniform(0.7, 1.2), 0, 255), rng.uniform(1.5, 9))


def tile_grid(image: ImageArray, rng: Rng) -> None:
    """Draw paving, bricks, concrete slabs or roof sheets: joints in two directions over a patch."""
    height, width = image.shape[:2]
    step = np.array([rng.uniform(7, 160), rng.uniform(7, 160)])
    half = rng.uniform(0.25, 1.6) * max(height, width) / 2
    counts = np.minimum(2 * half / step, 60).astype(int) + 1
    is_bond = rng.random() < 0.4
    layer = image.copy()
    base = float(image.mean())
    rgb = np.clip(np.full(3, base + rng.choice([-1, 1]) * rng.uniform(15, 90)) + rng.normal(0, 5, 3), 0, 255)
    joint = rng.uniform(1, 3.4)
    place = perspective(image, rng)
    for i in range(counts[0]):
        x = -half + i * step[0]
        if not is_bond:
            stroke(layer, place(np.array([[x, -half], [x, half]])), rgb, joint)
            continue
        for j in range(counts[1]):
            shifted = x + (j % 2) * step[0] / 2
            y = -half + j * step[1]
            stroke(layer, place(np.array([[shifted, y], [shifted, y + step[1]]])), rgb, joint)
    for j in range(counts[1]):
        y = -half + j * step[1]
        stroke(layer, place(np.array([[-half, y], [half, y]])), rgb, joint)
    opacity = rng.uniform(0.35, 1.0)
    cv2.addWeighted(layer, opacity, image, 1 - opacity, 0, dst=image)


def fence(image: ImageArray, rng: Rng) -> None:
    """Draw rails on posts, or rungs: parallel lines joined by many short ones."""
    place = perspective(image, rng)
    half, gap = rng.uniform(0.3, 1.2) * max(image.shape[:2]), rng.uniform(6, 40)
    rgb = np.clip(rng.uniform(20, 240) + rng.normal(0, 10, 3), 0, 255)
    rails, width = int(rng.integers(2, 5)), rng.uniform(1, 4)
    for k in range(rails):
        stroke(image, place(np.array([[-half, k * gap], [half, k * gap]])), rgb, width)
    for x in np.arange(-half, half, rng.uniform(5, 40)):
        post = np.array([[x, -gap * 0.3], [x, (rails - 1) * gap + gap * 0.3]])
        stroke(image, place(post), rgb, width * rng.uniform(0.8, 1.6))


def markings(image: ImageArray, rng: Rng) -> None:
    """Draw road paint: wide stripes, dashes, rows of parking bays."""
    place = perspective(image, rng)
    rgb = np.array([235, 235, 230]) if rng.random() < 0.7 else np.array([225, 175, 60])
    rgb = np.clip(rgb * rng.uniform(0.6, 1.05) + rng.normal(0, 5, 3), 0, 255)
    reach = float(max(image.shape[:2]))
    kind = rng.integers(3)
    if kind == 0:  # a stripe wider than any cable
        stroke(image, place(np.array([[-reach, 0], [reach, 0]])), rgb, rng.uniform(17, 45))
    elif kind == 1:  # dashes
        dash, width = rng.uniform(15, 90), rng.uniform(3, 20)
        for x in np.arange(-reach, reach, dash * rng.uniform(1.6, 3)):
            stroke(image, place(np.array([[x, 0], [x + dash, 0]])), rgb, width)
    else:  # bays
        step, depth, width = rng.uniform(20, 90), rng.uniform(30, 140), rng.uniform(2, 12)
        for x in np.arange(-reach, reach, step):
            stroke(image, place(np.array([[x, 0], [x + depth * 0.3, depth]])), rgb, width)


def furrows(image: ImageArray, rng: Rng) -> None:
    """Draw a field of soft parallel rows, bent and uneven."""
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
    put(image, image + (rows * np.float32(rng.uniform(6, 40)))[..., None])


def shadows(image: ImageArray, rng: Rng) -> None:
    """Draw shadows of wires: soft dark lines through which the ground is visible.

    Small pictures get none: in them a thin shadow looks like a thin dark wire.
    """
    height, width = image.shape[:2]
    if min(height, width) < MIN_DETAILED_PX:
        return
    reach = float(np.hypot(height, width))
    middle, angle, bend = anywhere(image, rng, 0), rng.uniform(0, np.pi), rng.normal(0, 0.02) / reach
    t = np.linspace(-1, 1, 25)[:, None] * reach
    shade, thickness = np.zeros((height, width), np.uint8), rng.uniform(1.5, 7)
    gap = rng.uniform(2.5, 8) * thickness if rng.random() < 0.5 else rng.uniform(10, 150)
    for k in range(int(rng.integers(1, 5))):
        turned = angle + rng.normal(0, 0.01)
        along, across = direction(turned), direction(turned + np.pi / 2)
        line = middle + along * t + across * (k * gap * rng.uniform(0.8, 1.2) + bend * t**2)
        fixed = np.round((line - 0.5) * SCALE).astype(np.int32)
        cv2.polylines(shade, [fixed], False, 255, max(1, round(thickness)), cv2.LINE_AA, SHIFT)
    soft = np.asarray(cv2.GaussianBlur(shade, (0, 0), rng.uniform(0.25, 0.6) * thickness + 0.4), np.float32)
    deep = rng.uniform(0.2, 0.65) * np.array([1.0, 0.97, 0.9])  # the sky still lights it
    put(image, image * (1 - soft[..., None] / 255 * deep))
