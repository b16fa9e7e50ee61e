"""Focal lengths in pixels by what cameras state of their lenses."""

from __future__ import annotations

import math
import tomllib
from functools import cache

from inspect_pipeline.resources import read_schema

_FILM_DIAGONAL_MM = math.hypot(36, 24)
_SENSOR_SHAPE = 4 / 3  # width to height of most sensors; those of 1 inch have 3:2, 4 % off


def focal_px_of_film(focal_35mm: float, image_size: tuple[int, int]) -> float:
    """Return the focal length of an image (height, width) by that for 35 mm film: diagonals compare."""
    return focal_35mm * math.hypot(*image_size) / _FILM_DIAGONAL_MM


def focal_px_of_video(focal_35mm: float, width_px: int) -> float:
    """Return the same of a video that shows the whole width of its sensor, whatever its own shape."""
    return focal_px_of_film(focal_35mm, (round(width_px / _SENSOR_SHAPE), width_px))


def focal_px_of_sensor(focal_mm: float, model: str, image_size: tuple[int, int]) -> float | None:
    """Return the same by the focal length itself, None where the sensor of the camera is not known."""
    width_mm = _sensor_widths_mm().get(model)
    return focal_mm * max(image_size) / width_mm if width_mm else None


@cache
def _sensor_widths_mm() -> dict[str, float]:
    widths_mm: dict[str, float] = tomllib.loads(read_schema("sensors.toml"))["widths_mm"]
    return widths_mm
