"""Physically based pictures of cables with Mitsuba 3 (extra `synth`), with alpha.

Stranded aluminium, insulated and rusty cables, alone, in families and in bundles with spacers, some held by
strings of insulators or beside a pole or a lattice tower; lit by environment maps or a sunny sky, through a
lens of finite aperture.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lsnet.errors import LSNetError
from lsnet.synth.pbr.conductors import Camera, Hang, strands
from lsnet.synth.pbr.hardware import insulators, lattice_tower, pole, triple

if TYPE_CHECKING:
    from lsnet.arrays import Floats, ImageArray, Rng
    from lsnet.synth.pbr.hardware import Rod


MIN_STRANDED_PX = 4.0  # strands of thinner cables are not visible
MARGIN = 1.3  # factor by which cables are longer than the visible width
SAMPLES = 32  # rays per pixel
INSULATED_SHARE = 0.15  # of cables or bundles hang from a visible string of insulators


@dataclass(frozen=True, slots=True)
class Cable:
    """One conductor of a scene: its course, its radius and its Mitsuba material."""

    hang: Hang
    radius_m: float
    material: dict[str, Any]
    is_stranded: bool


@dataclass(frozen=True, slots=True)
class SceneLayout:
    """A scene before it is rendered; the rods are spacers, insulators, poles and towers."""

    camera: Camera
    cables: tuple[Cable, ...]
    rods: tuple[Rod, ...]
    half_length_m: float
    aperture_m: float
    focus_m: float

    def lines(self) -> list[Floats]:
        """Return the (K, 2) centreline of each cable in pixels."""
        s = np.linspace(-self.half_length_m, self.half_length_m, 129)
        return [self.camera.project(cable.hang.points(s)) for cable in self.cables]


def lay_out(rng: Rng, size: int) -> SceneLayout:
    """Make a random scene; its sizes follow from a random width of the cables in the image."""
    radius_m, fov_deg = rng.uniform(0.006, 0.018), rng.uniform(18, 55)
    width_px = float(np.exp(rng.uniform(np.log(1.5), np.log(28))))
    focal_px = size / 2 / np.tan(np.radians(fov_deg) / 2)
    distance_m = 2 * radius_m * focal_px / width_px
    heading, elevation = rng.uniform(-0.6, 0.6), rng.uniform(-0.5, 1.35)
    view = np.array(
        [np.sin(heading) * np.cos(elevation), -np.cos(heading) * np.cos(elevation), np.sin(elevation)]
    )
    origin = distance_m * view
    seen_m = size / focal_px * distance_m
    camera = Camera(triple(origin), (0.0, 0.0, 0.0), fov_deg, size)
    cables, rods = _family(rng, seen_m, radius_m, width_px)
    rods += _structure(rng, seen_m)
    aperture_m = distance_m * rng.uniform(0.0005, 0.004)
    focus_m = distance_m * float(np.exp(rng.normal(0, 0.08)))
    return SceneLayout(camera, tuple(cables), tuple(rods), MARGIN * seen_m, aperture_m, focus_m)


def _structure(rng: Rng, seen_m: float) -> list[Rod]:
    """Return a pole or a lattice tower in one of four scenes."""
    if rng.random() > 0.25:
        return []
    foot = np.array([rng.uniform(-0.4, 0.4), rng.uniform(-0.3, 0.3), -1]) * seen_m
    height_m = seen_m * rng.uniform(1.05, 2)
    if rng.random() < 0.5:
        return pole(foot, height_m, seen_m * 0.03)
    return lattice_tower(foot, height_m, seen_m * rng.uniform(0.15, 0.5), int(rng.integers(4, 12)))


def _family(rng: Rng, seen_m: float, radius_m: float, width_px: float) -> tuple[list[Cable], list[Rod]]:
    """Return cables side by side through the view, single ones or bundles of 2 to 4 with spacers."""
    cables: list[Cable] = []
    rods: list[Rod] = []
    curvature, slope = abs(rng.normal(0, 0.06)) / seen_m, rng.normal(0, 0.08)
    along = np.array([np.cos(slope), 0.0, np.sin(slope)])
    in_bundle = int(rng.choice([1, 2, 3, 4], p=[0.7, 0.15, 0.05, 0.1]))
    gap_m = radius_m * rng.uniform(6, 25)
    for _ in range(int(rng.integers(1, 5 if in_bundle == 1 else 3))):
        place = np.array([0.0, rng.uniform(-0.4, 0.4), rng.uniform(-0.3, 0.3)]) * seen_m
        corners = [place + gap_m * np.array(c) / 2 for c in _BUNDLES[in_bundle]]
        material, is_stranded = _material(rng, width_px)
        cables += [
            Cable(Hang(triple(corner), triple(along), curvature), radius_m, material, is_stranded)
            for corner in corners
        ]
        at = rng.uniform(-0.4, 0.4) * seen_m * along
        at[2] += curvature * (at @ along) ** 2 / 2
        rods += [(triple(a + at), triple(b + at), radius_m * 0.8) for a, b in pairwise(corners)]
        if rng.random() < INSULATED_SHARE:
            rods += insulators(corners[0] + at, int(rng.integers(3, 16)))
    return cables, rods


_BUNDLES: dict[int, list[tuple[float, float, float]]] = {
    1: [(0, 0, 0)],
    2: [(0, -1, 0), (0, 1, 0)],
    3: [(0, -1, 0.6), (0, 1, 0.6), (0, 0, -1)],
    4: [(0, -1, -1), (0, 1, -1), (0, 1, 1), (0, -1, 1)],
}


def _material(rng: Rng, width_px: float) -> tuple[dict[str, Any], bool]:
    """Return aluminium from bright to weathered, insulation, or rust; and whether strands are visible."""
    kind, is_wide = (
        rng.choice(["aluminium", "insulated", "rusty"], p=[0.6, 0.27, 0.13]),
        width_px > MIN_STRANDED_PX,
    )
    if kind == "aluminium":
        tint = {"type": "rgb", "value": [float(rng.uniform(0.25, 1.0))] * 3}
        alpha = float(rng.uniform(0.12, 0.5))
        return {
            "type": "roughconductor",
            "material": "Al",
            "alpha": alpha,
            "specular_reflectance": tint,
        }, is_wide
    base = np.array([0.28, 0.12, 0.06]) if kind == "rusty" else np.array([0.03, 0.03, 0.03])
    colour = (base * rng.uniform(0.5, 2.0, 3)).clip(0, 0.9).tolist()
    diffuse = {"type": "rgb", "value": colour}
    if kind == "rusty":
        return {"type": "diffuse", "reflectance": diffuse}, is_wide
    return {"type": "roughplastic", "diffuse_reflectance": diffuse, "alpha": 0.25}, False


def render(layout: SceneLayout, light: Path | None, rng: Rng, samples: int = SAMPLES) -> ImageArray:
    """Render a scene under an environment map or a sunny sky; (H, W, 4) sRGB with straight alpha.

    Raises:
        LSNetError: Mitsuba is not installed or cannot read the map.
    """
    mi = load_mitsuba()
    camera = layout.camera
    to_world = mi.ScalarTransform4f().look_at(origin=camera.origin, target=camera.target, up=[0, 0, 1])
    film = {"type": "hdrfilm", "width": camera.size, "height": camera.size, "pixel_format": "rgba"}
    scene: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 5, "hide_emitters": True},
        "sensor": {
            "type": "thinlens",
            "fov": camera.fov_deg,
            "aperture_radius": layout.aperture_m,
            "focus_distance": layout.focus_m,
            "near_clip": 1e-3,
            "to_world": to_world,
            "film": film | {"rfilter": {"type": "box"}},
            "sampler": {"type": "independent", "sample_count": samples, "seed": int(rng.integers(2**31))},
        },
        "light": _light(mi, light, rng),
    }
    with tempfile.TemporaryDirectory() as folder:
        for k, cable in enumerate(layout.cables):
            path = Path(folder) / f"{k}.txt"
            path.write_text(_curves(cable, layout.half_length_m))
            scene[f"cable{k}"] = {"type": "bsplinecurve", "filename": str(path), "bsdf": cable.material}
        for k, rod in enumerate(layout.rods):
            grey = {"type": "diffuse", "reflectance": {"type": "rgb", "value": float(rng.uniform(0.1, 0.5))}}
            scene |= {f"rod{k}_{i}": shape | {"bsdf": grey} for i, shape in enumerate(_shapes(mi, rod))}
        try:
            pixels = np.array(mi.render(mi.load_dict(scene)), np.float64)
        except RuntimeError as err:
            if light is None:
                raise
            raise LSNetError(f"{light}: cannot be used as a light; remove it from the folder") from err
    return exposed(pixels, rng.uniform(0.08, 1.1))  # from dim to white


def _shapes(mi: Any, rod: Rod) -> list[dict[str, Any]]:
    """Return a cylinder, with closed ends if it is wider than long."""
    start, end, radius_m = rod
    shapes: list[dict[str, Any]] = [{"type": "cylinder", "p0": start, "p1": end, "radius": radius_m}]
    axis = np.subtract(end, start)
    if np.linalg.norm(axis) < 2 * radius_m:
        for place, outwards in ((start, -axis), (end, axis)):
            facing = mi.ScalarTransform4f().look_at(
                origin=place, target=triple(place + outwards), up=[1, 0, 0]
            )
            shapes.append({"type": "disk", "to_world": facing @ mi.ScalarTransform4f().scale(radius_m)})
    return shapes


def _curves(cable: Cable, half_length_m: float) -> str:
    """Return control points with radius in Mitsuba's format: one per line, an empty line between curves."""
    if cable.is_stranded:
        curves, radius_m = strands(cable.hang, cable.radius_m, half_length_m)
    else:
        s = np.linspace(-half_length_m, half_length_m, 33)
        curves, radius_m = [cable.hang.points(s)], cable.radius_m
    rows = (
        "\n".join(f"{x:.7g} {y:.7g} {z:.7g} {radius_m:.7g}" for x, y, z in curve.tolist()) for curve in curves
    )
    return "\n\n".join(rows) + "\n"


def _light(mi: Any, light: Path | None, rng: Rng) -> dict[str, Any]:
    turn = float(rng.uniform(0, 360))
    if light is None:
        up, around = np.radians(rng.uniform(8, 80)), np.radians(turn)
        towards = [np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)]
        return {"type": "sunsky", "sun_direction": towards, "turbidity": float(rng.uniform(2, 8))}
    upright = mi.ScalarTransform4f().rotate([0, 0, 1], turn).rotate([1, 0, 0], 90)
    return {"type": "envmap", "filename": str(light), "to_world": upright}


def exposed(pixels: Floats, brightness: float) -> ImageArray:
    """Convert linear (H, W, 4) to sRGB with alpha; bright parts of cables get `brightness`, 1 is white."""
    alpha = np.clip(pixels[..., 3:], 0, 1)
    colour = np.maximum(np.nan_to_num(pixels[..., :3]), 0) / np.maximum(alpha, 1e-3)
    is_cable = alpha[..., 0] > 0.3
    bright = np.percentile(colour[is_cable].mean(axis=1), 95) if is_cable.any() else 1.0
    lit = np.clip(colour * brightness / max(bright, 1e-6), 0, 1) ** (1 / 2.2)
    return np.round(np.concatenate([lit, alpha], axis=2) * 255).astype(np.uint8)


def load_mitsuba() -> Any:
    """Import Mitsuba, on one thread. Raises LSNetError when it is not installed."""
    try:
        import drjit  # noqa: PLC0415 -- an extra
        import mitsuba  # noqa: PLC0415
    except ImportError as err:
        raise LSNetError("mitsuba is not installed; pip install 'lsnet-pipe[synth]'") from err
    mitsuba.set_variant("scalar_rgb")
    drjit.set_thread_count(1)
    return mitsuba
