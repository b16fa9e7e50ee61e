"""Render the wires of a known scene with Mitsuba 3 (extra `synth`), with alpha to lay them over a picture."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from lsnet.synth.pbr.render import SAMPLES, exposed, load_mitsuba

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lsnet.arrays import Floats, ImageArray


_ALUMINIUM = {
    "type": "roughconductor",
    "material": "Al",
    "alpha": 0.3,
    "specular_reflectance": {"type": "rgb", "value": [0.75] * 3},
}
_BRIGHTNESS = 0.75  # linear, of the brightest wires


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A pinhole camera: position (3,); rotation (3, 3) with rows right, down, ahead; (height, width)."""

    position: Floats
    rotation: Floats
    focal_px: float
    image_size: tuple[int, int]


def render_wires(wires: Sequence[tuple[Floats, float]], view: View, sun: Floats) -> ImageArray:
    """Render aluminium wires under a clear sky; the same wires give the same image.

    Args:
        wires: Per wire, points (N, 3) at even steps along it, z up, and its radius, all in m.
        view: The camera.
        sun: (3,) direction towards the sun.

    Returns:
        (H, W, 4) sRGB with straight alpha.

    Raises:
        LSNetError: Mitsuba is not installed.
    """
    mi = load_mitsuba()
    height, width = view.image_size
    _, down, ahead = view.rotation
    place = [vector.tolist() for vector in (view.position, view.position + ahead, -down)]
    film = {"type": "hdrfilm", "width": width, "height": height, "pixel_format": "rgba"}
    scene = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 5, "hide_emitters": True},
        "sensor": {
            "type": "perspective",
            "fov": float(np.degrees(2 * np.arctan(width / 2 / view.focal_px))),
            "near_clip": 0.1,
            "to_world": mi.ScalarTransform4f().look_at(*place),
            "film": film | {"rfilter": {"type": "box"}},
            "sampler": {"type": "independent", "sample_count": SAMPLES},
        },
        "light": {"type": "sunsky", "sun_direction": sun.tolist(), "turbidity": 3.0},
    }
    with tempfile.TemporaryDirectory() as folder:
        for k, (points, radius_m) in enumerate(wires):
            path = Path(folder) / f"{k}.txt"
            ends = 2 * points[[0, -1]] - points[[1, -2]]  # a B-spline begins after its first point
            controls = np.vstack((ends[:1], points, ends[1:]))
            np.savetxt(path, np.column_stack((controls, np.full(len(controls), radius_m))), "%.7g")
            scene[f"wire{k}"] = {"type": "bsplinecurve", "filename": str(path), "bsdf": _ALUMINIUM}
        return exposed(np.array(mi.render(mi.load_dict(scene)), np.float64), _BRIGHTNESS)
