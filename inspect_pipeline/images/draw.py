"""Lines drawn onto pictures, and pictures written to files."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import cv2
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from inspect_pipeline.atomic import appearing
from inspect_pipeline.errors import OutputError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from inspect_pipeline.arrays import Floats, Floats32, ImageArray

_SHIFT = 4  # fractional bits of the coordinates given to OpenCV
_FAINT_RGB = np.array([90.0, 130.0, 255.0])  # two colours that neither foliage, soil nor steel has
_SURE_RGB = np.array([255.0, 0.0, 140.0])
# Of tracks, one after the other: bright, and apart from each other also for the colour-blind.
_TRACK_RGB = np.array(
    [[255, 64, 164], [0, 204, 255], [255, 225, 60], [178, 132, 255], [255, 140, 30], [120, 255, 150]],
    np.uint8,
)
_NO_TRACK_RGB = np.array([235, 235, 235], np.uint8)
_SCORE_SHARE = 0.08  # of a line, where its score stands
_STRIP_RGB = (20, 24, 30)
_MAP_SHARE = 0.75  # of the heat map over its picture


def score_colours(scores: Floats32, min_score: float = 0.0) -> ImageArray:
    """Return (N, 3) RGB colours, blue at `min_score` and pink at a score of 1."""
    share = np.clip((np.asarray(scores) - min_score) / max(1 - min_score, 1e-6), 0, 1)[:, np.newaxis]
    colours: ImageArray = np.rint(_FAINT_RGB + share * (_SURE_RGB - _FAINT_RGB)).astype(np.uint8)
    return colours


def track_colours(track_ids: Sequence[int | None]) -> ImageArray:
    """Return (N, 3) RGB colours, the same for the lines of a track in all frames; grey without a track."""
    found = [_NO_TRACK_RGB if i is None else _TRACK_RGB[i % len(_TRACK_RGB)] for i in track_ids]
    return np.array(found, np.uint8).reshape(-1, 3)


def draw_lines(image: ImageArray, lines: Sequence[Floats32], colours: ImageArray) -> ImageArray:
    """Return a copy of an RGB image with each polyline (N, 2), in pixels, between two rails of its colour.

    The wire itself stays visible between the rails. `colours` is (number of lines, 3) RGB.
    """
    rail_px = max(1, round(max(image.shape) / 800))
    gap_px = max(3, 2 * rail_px + 1)
    paint, cover = image.copy(), np.zeros(image.shape[:2], np.uint8)
    # OpenCV counts from the centre of the top-left pixel.
    strokes = [np.rint((points - 0.5) * (1 << _SHIFT)).astype(np.int32) for points in lines]
    for stroke, colour in zip(strokes, colours.tolist(), strict=True):
        cv2.polylines(paint, [stroke], False, colour, gap_px + 2 * rail_px + 2, cv2.LINE_8, _SHIFT)
        cv2.polylines(cover, [stroke], False, 255, gap_px + 2 * rail_px, cv2.LINE_AA, _SHIFT)
    for stroke in strokes:
        cv2.polylines(cover, [stroke], False, 0, gap_px, cv2.LINE_AA, _SHIFT)
    return _blend(image, paint, np.divide(cover, 255, dtype=np.float32))


def draw_scores(image: ImageArray, lines: Sequence[Floats32], scores: Floats32) -> ImageArray:
    """Return a copy of an RGB image with the score of each line near its first point, two digits."""
    picture, font = Image.fromarray(image), _font(image)
    pen = ImageDraw.Draw(picture)
    for number, (points, score) in enumerate(zip(lines, scores.tolist(), strict=True)):
        share = _SCORE_SHARE * (1 + number % 3)  # so that those of neighbours stand apart
        at = points[0] + share * (points[-1] - points[0])
        pen.text(tuple(at.tolist()), f"{score:.2f}", "white", font, stroke_width=2, stroke_fill="black")
    return _to_array(picture)


def draw_place(image: ImageArray, place: Floats, radius_px: float, text: str = "") -> ImageArray:
    """Return a copy of an RGB image with a ring around a place (x, y), and a text above it."""
    picture, font = Image.fromarray(image), _font(image)
    pen, width = ImageDraw.Draw(picture), max(2, round(max(image.shape) / 500))
    x, y = place.tolist()
    box = (x - radius_px, y - radius_px, x + radius_px, y + radius_px)
    pen.ellipse([box[0] - 1, box[1] - 1, box[2] + 1, box[3] + 1], outline="black", width=width + 2)
    pen.ellipse(box, outline="white", width=width)
    where = x, max(y - radius_px - width, font.size)
    pen.text(where, text, "white", font, anchor="mb", stroke_width=2, stroke_fill="black")
    return _to_array(picture)


def add_strip(image: ImageArray, left: str, right: str) -> ImageArray:
    """Return an RGB image with a dark strip of two texts below it; the left one is cut where it is long."""
    font, width = _font(image), image.shape[1]
    strip = Image.new("RGB", (width, round(1.9 * font.size)), _STRIP_RGB)
    pen, margin = ImageDraw.Draw(strip), font.size // 2
    room = width - 3 * margin - pen.textlength(right, font)
    while left and pen.textlength(left, font) > room:
        left = left[:-1]
    middle = strip.height / 2
    pen.text((margin, middle), left, "white", font, anchor="lm")
    pen.text((width - margin, middle), right, "white", font, anchor="rm")
    return np.concatenate((image, _to_array(strip)))


def _font(image: ImageArray) -> ImageFont.FreeTypeFont:
    """Return a font whose size goes with that of the image."""
    return cast("ImageFont.FreeTypeFont", ImageFont.load_default(max(11.0, max(image.shape) / 70)))


def _to_array(picture: Image.Image) -> ImageArray:
    return np.asarray(picture, np.uint8)


def draw_heat(image: ImageArray, confidence: Floats32) -> ImageArray:
    """Return an RGB image under a heat map of `confidence` (height, width) in [0, 1]."""
    levels = np.rint(np.clip(confidence, 0, 1) * 255).astype(np.uint8)
    heat = cv2.cvtColor(cv2.applyColorMap(levels, cv2.COLORMAP_INFERNO), cv2.COLOR_BGR2RGB)
    return _blend(image, np.asarray(heat, np.uint8), np.full(confidence.shape, _MAP_SHARE, np.float32))


def write_picture(path: Path, image: ImageArray) -> None:
    """Write an RGB image, whole or not at all, in the format that the suffix names. Raises OutputError."""
    try:
        is_known, data = cv2.imencode(path.suffix, cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
    except cv2.error:
        is_known = False
    if not is_known:
        raise OutputError(path, "the suffix names no picture format", "end it in .png or .jpg")
    try:
        with appearing(path) as part:
            part.write_bytes(data.tobytes())
    except OSError as error:
        raise OutputError(path, f"cannot be written ({error.strerror})", "name another file") from error


def _blend(below: ImageArray, above: ImageArray, cover: Floats32) -> ImageArray:
    share = cover[:, :, np.newaxis]
    blended: ImageArray = np.rint(below * (1 - share) + above * share).astype(np.uint8)
    return blended
