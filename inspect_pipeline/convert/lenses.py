"""Focal lengths in pixels by what cameras state of their lenses."""

from __future__ import annotations

import math
import tomllib
from functools import cache

from inspect_pipeline.resources import read_schema

_FILM_DIAGONAL_MM = math.hypot(36, 24)
_SENSOR_SHAPE = 4 / 3  # width to height of most sensors; those of 1 inch have 3:2, 4 % off
_WIDEST_SHAPE = 1.6  # of whole sensors: images of 16:9 show the whole width and not the whole height


def focal_px_of_film(focal_35mm: float, image_size: tuple[int, int]) -> float:
    """Return the focal length of an image (height, width) by that for 35 mm film, by diagonals of sensors."""
    longer, shorter = max(image_size), min(image_size)
    if longer / shorter > _WIDEST_SHAPE:
        return focal_35mm * math.hypot(longer, longer / _SENSOR_SHAPE) / _FILM_DIAGONAL_MM
    return focal_35mm * math.hypot(longer, shorter) / _FILM_DIAGONAL_MM


def focal_px_of_sensor(focal_mm: float, model: str, image_size: tuple[int, int]) -> float | None:
    """Return the same from the focal length itself, None where the sensor of the camera is not known."""
    width_mm = _sensor_widths_mm().get(model)
    return focal_mm * max(image_size) / width_mm if width_mm else None


@cache
def _sensor_widths_mm() -> dict[str, float]:
    widths_mm: dict[str, float] = tomllib.loads(read_schema("sensors.toml"))["widths_mm"]
    return widths_mm
