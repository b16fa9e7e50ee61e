"""Cables are drawn along the centrelines that are returned."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest

from lsnet.synth.cables import Arc, Finish, draw_cable
from lsnet.synth.scene import add_cables

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Image = NDArray[np.float32]


FLAT = Finish((0.0, 0.0, 0.0), ambient=1.0, diffuse=0.0, specular=0.0, light=0.0, strand_px=0.0)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def slanted(degrees: float, sag_px: float = 0.0) -> Arc:
    along = np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))]) * 150
    start, end = np.array([64.3, 63.8]) - along, np.array([64.3, 63.8]) + along
    return Arc((start[0], start[1]), (end[0], end[1]), sag_px)


@pytest.mark.parametrize("sag_px", [0.0, 12.0, -30.0])
@pytest.mark.parametrize("degrees", [0, 17, 45, 90, 120])
@pytest.mark.parametrize("width_px", [1.0, 4.0, 11.0])
def test_a_cable_is_drawn_along_its_centreline(width_px: float, degrees: float, sag_px: float) -> None:
    """The centroid of what is dark, across the cable, is on the line through its points."""
    image = np.full((128, 128, 3), 200, np.float32)
    arc = slanted(degrees, sag_px)
    draw_cable(image, arc, (width_px, width_px), FLAT)
    darkness, widths = 200 - image[..., 0], []
    points = arc.points(601)
    middles, directions = (points[1:] + points[:-1]) / 2, np.diff(points, axis=0)
    inside = np.all((middles > 20) & (middles < 108), axis=1)
    assert inside.any()
    for middle, direction in zip(middles[inside][::6], directions[inside][::6], strict=True):
        normal = np.array([-direction[1], direction[0]]) / np.hypot(*direction)
        t = np.linspace(-12, 12, 241)
        across = middle + t[:, None] * normal - 0.5  # OpenCV counts from pixel centres
        sampled = cv2.remap(
            darkness, across[:, :1].astype(np.float32), across[:, 1:].astype(np.float32), cv2.INTER_LINEAR
        )[:, 0]
        assert (sampled * t).sum() / sampled.sum() == pytest.approx(0, abs=0.25)
        widths.append(sampled.sum() * 0.1 / 200)
    assert np.mean(widths) == pytest.approx(width_px, rel=0.1)


@pytest.mark.parametrize("width_px", [0.2, 0.5, 0.9])
def test_cables_under_a_pixel_fade(width_px: float) -> None:
    image = np.full((64, 64, 3), 200, np.float32)
    draw_cable(image, Arc((-5, 32.5), (70, 32.5), 0.0), (width_px, width_px), FLAT)
    darkness = 200 - image[..., 0]
    np.testing.assert_allclose(darkness.sum(axis=0) / 200, width_px, rtol=0.02)
    np.testing.assert_allclose(darkness.max(axis=0) / 200, width_px, rtol=0.02)


def test_a_cable_narrows_towards_its_end_and_stops_there() -> None:
    image = np.full((64, 200, 3), 200, np.float32)
    draw_cable(image, Arc((20, 32), (180, 32), 0.0), (12, 4), FLAT)
    width = (200 - image[..., 0]).sum(axis=0) / 200
    np.testing.assert_allclose(
        width[[40, 100, 160]], [12 - 8 * (x - 19.5) / 160 for x in (40, 100, 160)], atol=0.2
    )
    assert not width[:18].any()
    assert not width[182:].any()


def test_leaves_hide_a_cable() -> None:
    image, visible = np.full((32, 64, 3), 200, np.float32), np.ones((32, 64), np.float32)
    visible[:, 20:40] = 0
    draw_cable(image, Arc((-5, 16), (70, 16), 0.0), (4, 4), FLAT, visible)
    assert (image[:, 20:40] == 200).all()
    assert (image[15, :20] == 0).all()


def test_light_falls_on_one_side_and_strands_repeat_along_the_cable() -> None:
    image = np.full((32, 200, 3), 100, np.float32)
    lit = Finish((150.0, 150.0, 150.0), 0.4, 0.6, 0.0, light=0.9, strand_px=12.0)
    draw_cable(image, Arc((-5, 16), (205, 16), 0.0), (12, 12), lit)
    # The light is to the right of the direction of travel, which is down for a cable drawn rightwards.
    assert image[20, :, 0].mean() > image[12, :, 0].mean() + 30
    spectrum = np.abs(np.fft.rfft(image[16, 4:196, 0] - image[16, 4:196, 0].mean()))
    assert spectrum.argmax() == 192 / 12


def test_arcs_sag_to_the_right_of_their_direction() -> None:
    points = Arc((0, 0), (100, 0), 10.0).points(5)
    np.testing.assert_allclose(points, [[0, 0], [25, 7.5], [50, 10], [75, 7.5], [100, 0]])


def test_cable_outside_the_image_changes_nothing() -> None:
    image = np.full((32, 32, 3), 200, np.float32)
    draw_cable(image, Arc((-50, -90), (80, -90), 0.0), (8, 8), FLAT)
    assert (image == 200).all()


def test_every_drawn_cable_is_returned_and_nothing_else() -> None:
    """Each changed pixel is near a returned centreline; most pixels of centrelines have changed."""
    for seed in range(6):
        image = np.full((128, 128, 3), 120, np.float32)
        centrelines = add_cables(image, rng(seed))
        changed = np.abs(image - 120).max(axis=2) > 4
        drawn = np.zeros((128, 128), np.uint8)
        for line in centrelines:
            cv2.polylines(drawn, [np.round((line - 0.5) * 16).astype(np.int32)], False, 1, 1, cv2.LINE_8, 4)
        distance = cv2.distanceTransform(1 - drawn, cv2.DIST_L2, 5)
        assert changed.any() == drawn.any()
        if not drawn.any():
            continue
        assert distance[changed].max(initial=0) < 9.5
        assert changed[drawn > 0].mean() > 0.5
