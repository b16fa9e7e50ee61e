"""The ground as one picture that repeats: meadow, soil, a road across and a track along; or a photograph."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

if TYPE_CHECKING:
    from inspect_pipeline.arrays import Floats, Floats32, ImageArray, RealArray

TEXEL_M = 0.04
TILE_TEXELS = (1024, 4096)  # y, x
_TILE_Y_M, _TILE_X_M = (n * TEXEL_M for n in TILE_TEXELS)

_DARK_GRASS, _LIGHT_GRASS, _STRAW = (54, 72, 38), (120, 138, 76), (172, 162, 110)  # RGB
_SOIL, _ASPHALT, _GRAVEL, _PAINT = (134, 108, 80), (112, 112, 114), (150, 140, 122), (205, 205, 200)
_ROAD_X_M, _ROAD_HALF_M = 62.0, 2.9
_TRACK_Y_M, _RUT_M = 8.5, 0.8


def draw_ground(rng: np.random.Generator) -> ImageArray:
    """Return the RGB picture of a tile of ground: row i is y = i * TEXEL_M, column j is x = j * TEXEL_M."""
    y, x = (axis * np.float32(TEXEL_M) for axis in np.ogrid[: TILE_TEXELS[0], : TILE_TEXELS[1]])
    broad, tufts, blades = (_noise(rng, *band) for band in ((4.0, 60.0), (0.4, 4.0), (0.06, 0.5)))
    ground = _mix(_flat(_DARK_GRASS), _LIGHT_GRASS, 0.5 + 0.14 * broad + 0.18 * tufts + 0.2 * blades)
    ground = _mix(
        ground, _STRAW, _step(_noise(rng, 1.5, 25.0) + 0.5 * tufts + 0.35 * blades, 0.9, 2.0) * 0.75
    )
    ground = _mix(ground, _SOIL, _step(_noise(rng, 2.0, 40.0) + 0.4 * tufts, 1.5, 1.9) * 0.85)
    ground = _add_track(ground, x, y, tufts, blades)
    ground = _add_road(ground, x, y, tufts, blades)
    ground *= (1 + 0.06 * _noise(rng, 15.0, 80.0) + 0.05 * _noise(rng, 0.05, 0.2))[..., np.newaxis]
    return np.clip(ground, 0, 255).astype(np.uint8)


def lay_photograph(photograph: ImageArray) -> ImageArray:
    """Return a tile of ground of an RGB photograph from above, as wide as a drawn one, that repeats mirrored.

    Half of the tile's width is the width of the photograph, of which no more than a square is taken.
    """
    square = photograph[: photograph.shape[1]]
    height, width = square.shape[:2]
    half = TILE_TEXELS[1] // 2
    how = cv2.INTER_AREA if half < width else cv2.INTER_LINEAR
    fitted = cv2.resize(square, (half, max(1, round(height * half / width))), interpolation=how)
    beside = np.concatenate((fitted, fitted[:, ::-1]), axis=1)
    return np.concatenate((beside, beside[::-1])).astype(np.uint8, copy=False)


def ground_to_texels() -> Floats:
    """Return (3, 3) from homogeneous x, y in m to texels, counted from the centre of the first by OpenCV."""
    return np.array([[1 / TEXEL_M, 0, -0.5], [0, 1 / TEXEL_M, -0.5], [0, 0, 1]])


def _noise(rng: np.random.Generator, shortest_m: float, longest_m: float) -> Floats32:
    """Noise of mean 0 and variance 1 with wavelengths in a band, as strong at each octave; it tiles."""
    coarse = max(1, int(shortest_m / (8 * TEXEL_M)))  # texels in one that is fine enough for the band
    coarse = 1 << coarse.bit_length() - 1
    rows, columns = (n // coarse for n in TILE_TEXELS)
    fy, fx = np.fft.fftfreq(rows, TEXEL_M * coarse), np.fft.rfftfreq(columns, TEXEL_M * coarse)
    frequency = np.hypot(*np.meshgrid(fx, fy)).astype(np.float32)
    frequency[0, 0] = np.inf
    band = (
        np.exp(-((frequency * shortest_m) ** 4)) * (1 - np.exp(-((frequency * longest_m) ** 4))) / frequency
    )
    spectrum = np.fft.rfft2(rng.standard_normal((rows, columns), np.float32)) * band
    noise = np.fft.irfft2(spectrum, (rows, columns)).astype(np.float32)
    return _enlarge(noise / noise.std(), coarse)


def _enlarge(noise: Floats32, factor: int) -> Floats32:
    """Noise that tiles, with `factor` times as many texels each way."""
    if factor == 1:
        return noise
    border = 2
    wrapped = np.pad(noise, border, mode="wrap")
    fine = cv2.resize(wrapped, None, fx=factor, fy=factor, interpolation=cv2.INTER_CUBIC)
    inside = slice(border * factor, -border * factor)
    return fine[inside, inside].astype(np.float32, copy=False)


def _add_road(
    ground: Floats32,
    x: Floats32,
    y: Floats32,
    tufts: Floats32,
    blades: Floats32,
) -> Floats32:
    """An asphalt road across the line, with worn edges and a dashed middle."""
    off_m = np.abs(x - _ROAD_X_M - 3 * np.sin(2 * np.pi * y / _TILE_Y_M))
    ragged_m = off_m + 0.12 * tufts + 0.05 * blades
    ground = _mix(ground, _GRAVEL, _step(-ragged_m, -_ROAD_HALF_M - 0.9, -_ROAD_HALF_M - 0.2))
    asphalt = _mix(_flat(_ASPHALT), _GRAVEL, 0.12 + 0.05 * tufts + 0.07 * blades)
    ground = _mix(ground, asphalt, _step(-ragged_m, -_ROAD_HALF_M - 0.15, -_ROAD_HALF_M + 0.05))
    is_dash = (y / 2.56 % 2 < 1) & (off_m < 0.06)
    return _mix(ground, _PAINT, cv2.GaussianBlur(is_dash.astype(np.float32), (0, 0), 0.7) * 0.8)


def _add_track(
    ground: Floats32,
    x: Floats32,
    y: Floats32,
    tufts: Floats32,
    blades: Floats32,
) -> Floats32:
    """The two ruts of a field track beside the line."""
    off_m = np.abs(y - _TRACK_Y_M - 1.4 * np.sin(4 * np.pi * x / _TILE_X_M))
    rut_m = np.abs(off_m - _RUT_M) + 0.08 * tufts + 0.05 * blades
    return _mix(ground, _GRAVEL, _step(-rut_m, -0.5, -0.1) * 0.85)


def _flat(colour: tuple[int, int, int]) -> Floats32:
    return np.full((*TILE_TEXELS, 3), colour, np.float32)


def _mix(
    below: Floats32,
    above: tuple[int, int, int] | Floats32,
    share: RealArray,
) -> Floats32:
    """`below` covered by `above` to a share in [0, 1] of each texel."""
    clipped = np.clip(share, 0, 1)[..., np.newaxis].astype(np.float32)
    mixed: Floats32 = below + (np.asarray(above, np.float32) - below) * clipped
    return mixed


def _step(value: RealArray, low: float, high: float) -> RealArray:
    """0 below `low`, 1 above `high`, smooth between."""
    t: RealArray = np.clip((value - low) / (high - low), 0, 1)
    t *= t * (3 - 2 * t)
    return t
