"""What a drone writes into its JPEGs: when, where and which way, by EXIF and DJI's XMP."""

from __future__ import annotations

import math
import re
import warnings
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Any

from PIL import ExifTags, Image, UnidentifiedImageError

from inspect_pipeline.geometry.attitude import Position, YawPitchRoll, position

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

_DJI = re.compile(rb'drone-dji:(\w+)(?:="([^"]*)"|>([^<]*)<)')
_OFFSET = re.compile(r"([+-])(\d\d):(\d\d)")
_FILM_DIAGONAL_MM = math.hypot(36, 24)


@dataclass(frozen=True, slots=True)
class PhotographTags:
    """What a photograph says of itself; what it does not say is None.

    clock is the camera's own, without a zone; zone is that of the clock, by EXIF; gps_clock is in UTC.
    image_size is (height, width). focal_px is by the focal length for 35 mm film. height_m is above take-off.
    """

    image_size: tuple[int, int]
    clock: datetime | None
    zone: timedelta | None
    gps_clock: datetime | None
    position: Position | None
    gimbal: YawPitchRoll | None
    focal_px: float | None
    height_m: float | None


def read_tags(path: Path) -> PhotographTags | None:
    """What the head of an image file says; None when it is no image, or damaged. Raises OSError."""
    try:
        with warnings.catch_warnings(action="ignore"), Image.open(path) as image:
            exif, xmp = image.getexif(), image.info.get("xmp", b"")
            width, height = image.size
            camera, gps = exif.get_ifd(ExifTags.IFD.Exif), exif.get_ifd(ExifTags.IFD.GPSInfo)
    except (UnidentifiedImageError, Image.DecompressionBombError, SyntaxError, ValueError):
        return None
    except OSError as error:
        if error.errno is None:  # not of the disk: Pillow's own word for tags that are cut off
            return None
        raise
    dji = _dji_fields(xmp if isinstance(xmp, bytes) else xmp.encode())
    return PhotographTags(
        image_size=(height, width),
        clock=_clock(camera),
        zone=_zone(camera.get(ExifTags.Base.OffsetTimeOriginal)),
        gps_clock=_gps_clock(gps),
        position=_position(gps),
        gimbal=_gimbal(dji),
        focal_px=_focal_px(camera, math.hypot(height, width)),
        height_m=_number(dji.get("RelativeAltitude")),
    )


def _clock(camera: Mapping[int, Any]) -> datetime | None:
    try:
        clock = datetime.strptime(
            str(camera.get(ExifTags.Base.DateTimeOriginal)).rstrip("\0 "), "%Y:%m:%d %H:%M:%S"
        )
    except ValueError:
        return None
    digits = re.match(r"\d{1,6}", str(camera.get(ExifTags.Base.SubsecTimeOriginal, "")))
    return clock.replace(microsecond=int(digits[0].ljust(6, "0")) if digits else 0)


def _zone(offset: Any) -> timedelta | None:
    match = _OFFSET.match(str(offset))
    if match is None:
        return None
    zone = timedelta(hours=int(match[2]), minutes=int(match[3]))
    return -zone if match[1] == "-" else zone


def _gps_clock(gps: Mapping[int, Any]) -> datetime | None:
    try:
        day = datetime.strptime(str(gps[ExifTags.GPS.GPSDateStamp]).rstrip("\0 "), "%Y:%m:%d")
        hours, minutes, seconds = (float(value) for value in gps[ExifTags.GPS.GPSTimeStamp])
        return (day + timedelta(hours=hours, minutes=minutes, seconds=seconds)).replace(tzinfo=UTC)
    except (KeyError, TypeError, ValueError, ArithmeticError):
        return None


def _position(gps: Mapping[int, Any]) -> Position | None:
    try:
        latitude_deg = _degrees(gps[ExifTags.GPS.GPSLatitude], gps[ExifTags.GPS.GPSLatitudeRef] == "S")
        longitude_deg = _degrees(gps[ExifTags.GPS.GPSLongitude], gps[ExifTags.GPS.GPSLongitudeRef] == "W")
        altitude_m = float(gps.get(ExifTags.GPS.GPSAltitude, math.nan))
    except (KeyError, TypeError, ValueError, ArithmeticError):
        return None
    is_below = gps.get(ExifTags.GPS.GPSAltitudeRef) in {1, b"\1"}
    return position(latitude_deg, longitude_deg, -altitude_m if is_below else altitude_m)


def _degrees(parts: Any, is_negative: bool) -> float:
    degrees, minutes, seconds = (float(part) for part in parts)
    value = degrees + minutes / 60 + seconds / 3600
    return -value if is_negative else value


def _dji_fields(xmp: bytes) -> dict[str, bytes | None]:
    return {match[1].decode(): match[2] or match[3] for match in _DJI.finditer(xmp)}


def _gimbal(fields: Mapping[str, bytes | None]) -> YawPitchRoll | None:
    turns = [_number(fields.get(f"Gimbal{turn}Degree")) for turn in ("Yaw", "Pitch", "Roll")]
    return YawPitchRoll(*(turn for turn in turns if turn is not None)) if None not in turns else None


def _number(text: bytes | None) -> float | None:
    try:
        return float(text or b"")
    except ValueError:
        return None


def _focal_px(camera: Mapping[int, Any], diagonal_px: float) -> float | None:
    focal_mm = camera.get(ExifTags.Base.FocalLengthIn35mmFilm)
    if not isinstance(focal_mm, int) or focal_mm <= 0:
        return None
    return focal_mm * diagonal_px / _FILM_DIAGONAL_MM
