"""Wires of a known scene as Mitsuba 3 sees them (extra `synth`): colours and alpha, to lay over a picture."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from lsnet.synth.pbr.render import SAMPLES, exposed, load_mitsuba

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

_ALUMINIUM = {
    "type": "roughconductor",
    "material": "Al",
    "alpha": 0.3,
    "specular_reflectance": {"type": "rgb", "value": [0.75] * 3},
}
_BRIGHTNESS = 0.75  # linear, of the brightest wires


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A pinhole camera: (3,) where it is, (3, 3) right, down and ahead, and an image of (height, width)."""

    position: NDArray[np.float64]
    rotation: NDArray[np.float64]
    focal_px: float
    image_size: tuple[int, int]


def render_wires(
    wires: Sequence[tuple[NDArray[np.float64], float]], view: View, sun: NDArray[np.float64]
) -> NDArray[np.uint8]:
    """(H, W, 4) sRGB and alpha, not multiplied in, of aluminium wires under a clear sky; z is up.

    wires: (N, 3) points in m, at even steps along each, and its radius. sun: (3,) towards it. The same wires
    give the same image. Raises LSNetError when Mitsuba is not installed.
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
