"""Draw a frame of a simulated flight: ground, trees, poles and conductors in the view of the camera."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from inspect_pipeline.simulation.ground import TEXEL_M, ground_to_texels
from inspect_pipeline.simulation.hills import draw_hills
from inspect_pipeline.simulation.options import RenderKind, TowerKind
from inspect_pipeline.simulation.power_line import POLE_HEIGHT_M
from inspect_pipeline.simulation.scene import SimulatedCamera, Tree, visible_parts
from inspect_pipeline.simulation.towers import SUBPIXEL_BITS, draw_beam, draw_pole, draw_tower

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from inspect_pipeline.arrays import Floats, Floats32, ImageArray, Mask, RealArray
    from inspect_pipeline.simulation.power_line import Conductor, Structure
    from inspect_pipeline.simulation.records import Quality
    from inspect_pipeline.simulation.route import Route


_FINER = 4  # conductors are drawn this much larger, then averaged
_LEAVES_DARK, _LEAVES_LIGHT = np.array((22, 36, 18)), np.array((112, 132, 66))  # RGB
_AUTUMN = np.array((26, 10, -6))  # added to a tree of tint 1
_SHADOW = 0.55  # share of the light that is missing
_HAZE = np.array((198, 204, 210), np.float32)  # RGB
_MASK = ((1.0, 0.0, (255,)),)
_METAL = np.array((1.0, 0.99, 0.97))  # colour of the light that a conductor reflects
# Strokes of a conductor, dark rim to bright top: share of the width, shift to the light, brightness.
_ROUND = ((1.0, 0.0, 62), (0.78, 0.06, 104), (0.52, 0.1, 148), (0.26, 0.13, 186))
_NOISE = 2.5
_SPOILED: dict[Quality, tuple[float, float]] = {  # blur in px, gain
    "blurred": (6.0, 1.0),
    "dark": (0.6, 0.12),
    "overexposed": (0.6, 3.5),
}


@dataclass(frozen=True, slots=True, eq=False)
class Landscape:
    """What is drawn: the ground's tile, the trees on it, the conductors from below, and their structures.

    route: of the line, over the ground that it has. crossarm_half_m: from a pole to the end of its arm.
    sun: (3,) unit vector towards the sun. veil: share of the light that comes from haze.
    """

    ground: ImageArray
    trees: Sequence[Tree]
    conductors: Sequence[Conductor]
    structures: Sequence[Structure]
    route: Route
    crossarm_half_m: float
    sun: Floats
    towers: TowerKind = TowerKind.WOOD
    veil: float = 0.0


def render(
    landscape: Landscape,
    camera: SimulatedCamera,
    quality: Quality,
    rng: np.random.Generator,
    kind: RenderKind = RenderKind.DRAWN,
) -> ImageArray:
    """Return the RGB image (height, width, 3) the camera takes, with blur and noise, good or spoiled.

    Raises LSNetError when Mitsuba is needed and not installed.
    """
    is_flat = landscape.route.hills_m == 0
    image = (_draw_plane if is_flat else draw_hills)(landscape.ground, camera, landscape.route)
    for structure in landscape.structures:
        _draw_pole_shadow(image, camera, structure.foot, landscape.sun)
    for tree in _far_to_near(landscape.trees, camera):
        _draw_tree(image, camera, tree, landscape.sun)
    for structure in reversed(landscape.structures):
        draw = draw_pole if landscape.towers == TowerKind.WOOD else draw_tower
        draw(image, camera, structure, landscape.crossarm_half_m)
    put = _draw_conductors if kind == RenderKind.DRAWN else _trace_conductors
    sharp = put(image, camera, landscape) * (1 - landscape.veil) + landscape.veil * _HAZE
    sigma_px, gain = _SPOILED.get(quality, (0.6, 1.0))
    noise = _NOISE * rng.standard_normal(image.shape, np.float32)
    blurred = gain * cv2.GaussianBlur(sharp, (0, 0), sigma_px)
    taken: ImageArray = np.clip(blurred + noise, 0, 255).astype(np.uint8)
    return taken


def _draw_plane(ground: ImageArray, camera: SimulatedCamera, _: Route) -> ImageArray:
    """Draw the plane z = 0 by a homography, with the camera shifted onto the first tile."""
    tile_y_m, tile_x_m = (n * TEXEL_M for n in ground.shape[:2])
    x, y, z = camera.position
    moved = SimulatedCamera(
        np.array([x % tile_x_m, y % tile_y_m, z]), camera.rotation, camera.focal_px, camera.image_size
    )
    plane_to_pixel = moved.matrix[:, [0, 1, 3]]
    to_centre = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])
    to_texel = ground_to_texels() @ np.linalg.inv(plane_to_pixel) @ to_centre
    height, width = camera.image_size
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    image = cv2.warpPerspective(ground, to_texel, (width, height), flags=flags, borderMode=cv2.BORDER_WRAP)
    return image.astype(np.uint8, copy=False)


def _far_to_near(trees: Iterable[Tree], camera: SimulatedCamera) -> list[Tree]:
    """Return the trees that may be in the image."""
    height, width = camera.image_size
    placed = []
    for tree in trees:
        pixels, depths = camera.project(tree.clumps.mean(axis=0)[np.newaxis])
        margin = 8 * camera.focal_px / max(depths[0], 1)
        if depths[0] > 1 and np.all((pixels[0] > -margin) & (pixels[0] < np.add((width, height), margin))):
            placed.append((depths[0], tree))
    return [tree for _, tree in sorted(placed, key=lambda item: -item[0])]


def _draw_tree(image: ImageArray, camera: SimulatedCamera, tree: Tree, sun: Floats) -> None:
    """Draw the shadow of a tree, then its clumps of leaves from far to near."""
    on_ground = tree.clumps - sun * ((tree.clumps[:, 2:] - tree.ground_m) / sun[2])
    shadow = np.zeros(image.shape[:2], np.uint8)
    _draw_discs(shadow, camera, on_ground, 2 * tree.radii_m, np.full((len(on_ground), 1), 255))
    _darken(image, shadow)
    colours = _LEAVES_DARK + tree.light[:, np.newaxis] * (_LEAVES_LIGHT - _LEAVES_DARK) + tree.tint * _AUTUMN
    _draw_discs(image, camera, tree.clumps, tree.radii_m, colours)


def _draw_discs(
    image: ImageArray,
    camera: SimulatedCamera,
    centres: Floats,
    radii_m: Floats,
    colours: RealArray,
) -> None:
    pixels, depths = camera.project(centres)
    radii_px = radii_m * camera.focal_px / depths
    is_seen = (depths > 1) & _touches(pixels, radii_px + 1, camera.image_size)
    shown = np.flatnonzero(is_seen)[np.argsort(-depths[is_seen])]
    fixed = np.rint((pixels[shown] - 0.5) * (1 << SUBPIXEL_BITS)).astype(int).tolist()
    radii = np.rint(radii_px[shown] * (1 << SUBPIXEL_BITS)).astype(int).tolist()
    paints = np.clip(colours[shown], 0, 255).tolist()
    for centre, radius, paint in zip(fixed, radii, paints, strict=True):
        cv2.circle(image, centre, radius, paint, -1, cv2.LINE_AA, SUBPIXEL_BITS)


def _touches(pixels: Floats, radii_px: Floats, image_size: tuple[int, int]) -> Mask:
    """Return which discs overlap the image."""
    reach = radii_px[:, np.newaxis]
    is_near = (pixels > -reach) & (pixels < image_size[::-1] + reach)
    touches: Mask = np.all(is_near, axis=1)
    return touches


def _darken(image: ImageArray, shadow: ImageArray) -> None:
    """Shade the image where the mask `shadow` is 255, with soft edges."""
    x, y, width, height = cv2.boundingRect(shadow)
    if width and height:
        part = image[y : y + height, x : x + width]
        mask = cv2.GaussianBlur(shadow[y : y + height, x : x + width], (0, 0), 1.2)[..., np.newaxis] / 255
        part[:] = (part * (1 - _SHADOW * mask)).astype(np.uint8)


def _draw_pole_shadow(image: ImageArray, camera: SimulatedCamera, foot: Floats, sun: Floats) -> None:
    top = foot + np.array([0.0, 0.0, POLE_HEIGHT_M]) - sun * (POLE_HEIGHT_M / sun[2])
    shadow = np.zeros(image.shape[:2], np.uint8)
    draw_beam(shadow, camera, np.stack((foot, top)), 0.26, _MASK)
    _darken(image, shadow)


def _trace_conductors(image: ImageArray, camera: SimulatedCamera, landscape: Landscape) -> Floats32:
    """Return the image as float32, overlaid with ray-traced conductors."""
    from lsnet.synth.pbr.wires import View, render_wires  # noqa: PLC0415 - loads much

    wires = [
        (conductor.points[max(part.first - 1, 0) : part.last + 1], conductor.diameter_m / 2)
        for conductor in landscape.conductors
        for part in visible_parts(camera, conductor)
    ]
    view = View(camera.position, camera.rotation, camera.focal_px, camera.image_size)
    traced = render_wires(wires, view, landscape.sun).astype(np.float32)
    alpha = traced[..., 3:] / 255
    covered: Floats32 = (image * (1 - alpha) + traced[..., :3] * alpha).astype(np.float32)
    return covered


def _draw_conductors(image: ImageArray, camera: SimulatedCamera, landscape: Landscape) -> Floats32:
    """Return the image as float32, overlaid with conductors drawn at higher resolution and averaged."""
    height, width = camera.image_size
    fine = np.zeros((height * _FINER, width * _FINER, 2), np.uint8)  # brightness, coverage
    for conductor in landscape.conductors:
        for part in visible_parts(camera, conductor):
            _draw_strokes(fine, part.pixels * _FINER, part.widths_px * _FINER)
    averaged = cv2.resize(fine, (width, height), interpolation=cv2.INTER_AREA).astype(np.float32)
    covered: Floats32 = image * (1 - averaged[..., 1:] / 255) + averaged[..., :1] * _METAL
    return covered.astype(np.float32, copy=False)


def _draw_strokes(fine: ImageArray, pixels: Floats, widths_px: Floats) -> None:
    """Draw a round conductor along (N, 2) fine pixels: strokes of decreasing width and rising brightness."""
    along = np.gradient(pixels, axis=0)
    up = np.column_stack((along[:, 1], -along[:, 0])) / np.maximum(np.hypot(*along.T), 1e-6)[:, np.newaxis]
    up *= np.where(up[:, 1:] > 0, -1, 1)
    for share, shift, brightness in _ROUND:
        points = pixels + up * (shift * widths_px)[:, np.newaxis]
        fixed = np.rint((points - 0.5) * (1 << SUBPIXEL_BITS)).astype(int).tolist()
        strokes = np.maximum(np.rint(share * widths_px), 1).astype(int).tolist()
        for first, last, stroke in zip(fixed, fixed[1:], strokes[1:], strict=False):
            cv2.line(fine, first, last, (brightness, 255), stroke, cv2.LINE_8, SUBPIXEL_BITS)
