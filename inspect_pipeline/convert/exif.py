"""Read what a drone writes into its JPEGs: EXIF, and the XMP of DJI."""

from __future__ import annotations

import math
import re
import warnings
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Any

from defusedxml import DefusedXmlException
from defusedxml.ElementTree import ParseError, fromstring
from PIL import ExifTags, Image, UnidentifiedImageError

from inspect_pipeline.convert.lenses import focal_px_of_film, focal_px_of_sensor
from inspect_pipeline.geometry.attitude import Position, YawPitchRoll, position

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

_DJI = "{http://www.dji.com/drone-dji/1.0/}"
_OFFSET = re.compile(r"([+-])(\d\d):(\d\d)")
_UNITS_MM = {2: 25.4, 3: 10.0}  # of EXIF: inch, centimetre
_OFF_CENTRE = 0.1  # of the image's sides: farther off, a calibrated centre is of another image
# By the letter that DJI puts behind a picture's number, and by the XMP field ImageSource.
_LENS_OF_LETTER = {"W": "wide", "Z": "zoom", "T": "thermal", "V": "visible", "S": "screen"}
_LENS_OF_SOURCE = {"WideCamera": "wide", "ZoomCamera": "zoom", "InfraredCamera": "thermal"}
_LETTER = re.compile(r"\d_([A-Z])$")


@dataclass(frozen=True, slots=True)
class CameraKey:
    """Properties that distinguish the cameras of a folder; size is (height, width), texts may be empty."""

    lens: str
    model: str
    lens_model: str
    image_size: tuple[int, int]


@dataclass(frozen=True, slots=True)
class PhotographTags:
    """The tags of a photograph; None where it has none.

    clock: of the camera, without a time zone; zone: its offset from UTC by EXIF; gps_clock: UTC.
    focal_px: as calibrated by DJI, else by the focal length. height_m: above take-off.
    has_bad_xmp: its XMP is damaged or not plain XML, and was not used.
    """

    camera: CameraKey
    clock: datetime | None
    zone: timedelta | None
    gps_clock: datetime | None
    position: Position | None
    gimbal: YawPitchRoll | None
    focal_px: float | None
    height_m: float | None
    has_bad_xmp: bool = False


def read_tags(path: Path) -> PhotographTags | None:
    """Read the tags of an image file. Returns None when it is damaged or no image; raises OSError."""
    try:
        with warnings.catch_warnings(action="ignore"), Image.open(path) as image:
            exif, xmp = image.getexif(), image.info.get("xmp", b"")
            width, height = image.size
            camera, gps = exif.get_ifd(ExifTags.IFD.Exif), exif.get_ifd(ExifTags.IFD.GPSInfo)
    except (UnidentifiedImageError, Image.DecompressionBombError, SyntaxError, ValueError):
        return None
    except OSError as error:
        if error.errno is None:  # from Pillow, for tags that are cut off, and not from the disk
            return None
        raise
    dji = _dji_fields(xmp if isinstance(xmp, bytes) else xmp.encode())
    fields = dji or {}
    return PhotographTags(
        camera=CameraKey(
            _lens(path.stem, fields),
            _text(exif.get(ExifTags.Base.Model)),
            _text(camera.get(ExifTags.Base.LensModel)),
            (height, width),
        ),
        clock=_clock(camera),
        zone=_zone(camera.get(ExifTags.Base.OffsetTimeOriginal)),
        gps_clock=_gps_clock(gps),
        position=_position(gps) or _dji_position(fields),
        gimbal=_gimbal(fields),
        focal_px=_focal_px(camera, fields, _text(exif.get(ExifTags.Base.Model)), (height, width)),
        height_m=_number(fields.get("RelativeAltitude")),
        has_bad_xmp=dji is None,
    )


def _text(value: Any) -> str:
    return str(value or "").strip("\0 ")


def _lens(stem: str, dji: Mapping[str, str]) -> str:
    letter = _LETTER.search(stem)
    by_name = _LENS_OF_LETTER.get(letter[1], "") if letter else ""
    return _LENS_OF_SOURCE.get(dji.get("ImageSource", ""), by_name)


def _clock(camera: Mapping[int, Any]) -> datetime | None:
    try:
        clock = datetime.strptime(_text(camera.get(ExifTags.Base.DateTimeOriginal)), "%Y:%m:%d %H:%M:%S")
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
        day = datetime.strptime(_text(gps[ExifTags.GPS.GPSDateStamp]), "%Y:%m:%d")
        hours, minutes, seconds = (float(value) for value in gps[ExifTags.GPS.GPSTimeStamp])
        return (day + timedelta(hours=hours, minutes=minutes, seconds=seconds)).replace(tzinfo=UTC)
    except (KeyError, TypeError, ValueError, ArithmeticError):
        return None


def _position(gps: Mapping[int, Any]) -> Position | None:
    try:
        latitude_deg = _degrees(gps[ExifTags.GPS.GPSLatitude], gps[ExifTags.GPS.GPSLatitudeRef], "S")
        longitude_deg = _degrees(gps[ExifTags.GPS.GPSLongitude], gps[ExifTags.GPS.GPSLongitudeRef], "W")
        altitude_m = float(gps.get(ExifTags.GPS.GPSAltitude, math.nan))
    except (KeyError, TypeError, ValueError, ArithmeticError):
        return None
    is_below = gps.get(ExifTags.GPS.GPSAltitudeRef) in {1, b"\1"}
    return position(latitude_deg, longitude_deg, -altitude_m if is_below else altitude_m)


def _degrees(parts: Any, reference: Any, negative: str) -> float:
    degrees, minutes, seconds = (float(part) for part in parts)
    value = degrees + minutes / 60 + seconds / 3600
    return -value if _text(reference).upper() == negative else value


def _dji_fields(xmp: bytes) -> dict[str, str] | None:
    """Return DJI's fields by name, whether written as attributes or as elements; None for bad XMP.

    The XMP of a photograph needs no document type, and may not have one: entities could be bombs.
    """
    if not (text := xmp.strip(b"\0 \r\n\t")):
        return {}
    try:
        root = fromstring(text, forbid_dtd=True)
    except (ParseError, DefusedXmlException, ValueError, LookupError):
        return None
    fields: dict[str, str] = {}
    for element in root.iter():
        own = ((element.tag, element.text), *element.items())
        fields |= {name.removeprefix(_DJI): value or "" for name, value in own if name.startswith(_DJI)}
    return fields


def _gimbal(fields: Mapping[str, str]) -> YawPitchRoll | None:
    turns = [_number(fields.get(f"Gimbal{turn}Degree")) for turn in ("Yaw", "Pitch", "Roll")]
    return YawPitchRoll(*(turn for turn in turns if turn is not None)) if None not in turns else None


def _dji_position(fields: Mapping[str, str]) -> Position | None:
    """Return the position in XMP; the first drones that wrote it spelt GpsLongtitude."""
    latitude_deg = _number(fields.get("GpsLatitude"))
    longitude_deg = _number(fields.get("GpsLongitude", fields.get("GpsLongtitude")))
    if latitude_deg is None or longitude_deg is None:
        return None
    altitude_m = _number(fields.get("AbsoluteAltitude"))
    return position(latitude_deg, longitude_deg, math.nan if altitude_m is None else altitude_m)


def _number(text: str | None) -> float | None:
    try:
        value = float(text or "")
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _focal_px(
    camera: Mapping[int, Any], dji: Mapping[str, str], model: str, image_size: tuple[int, int]
) -> float | None:
    """Return the calibrated focal length, else that for 35 mm film, else that from the size of the sensor."""
    if calibrated_px := _calibrated_px(dji, image_size):
        return calibrated_px
    if focal_35mm := _positive(camera.get(ExifTags.Base.FocalLengthIn35mmFilm)):
        return focal_px_of_film(focal_35mm, image_size)
    focal_mm = _positive(camera.get(ExifTags.Base.FocalLength))
    if focal_mm is None:
        return None
    return focal_px_of_sensor(focal_mm, model, image_size) or _focal_plane_px(camera, focal_mm, image_size[1])


def _focal_plane_px(camera: Mapping[int, Any], focal_mm: float, width_px: int) -> float | None:
    """Return the focal length from the pixels per length of the sensor, in an image that may be smaller."""
    per_unit = _positive(camera.get(ExifTags.Base.FocalPlaneXResolution))
    unit_mm = _UNITS_MM.get(camera.get(ExifTags.Base.FocalPlaneResolutionUnit, 0))
    taken_px = _positive(camera.get(ExifTags.Base.ExifImageWidth))
    if per_unit is None or unit_mm is None or taken_px is None:
        return None
    return focal_mm / unit_mm * per_unit * width_px / taken_px


def _calibrated_px(dji: Mapping[str, str], image_size: tuple[int, int]) -> float | None:
    """Return DJI's own focal length in pixels, if it is of an image of this size."""
    names = ("CalibratedFocalLength", "CalibratedOpticalCenterX", "CalibratedOpticalCenterY")
    focal_px, x_px, y_px = (_number(dji.get(name)) for name in names)
    if not focal_px or focal_px <= 0 or x_px is None or y_px is None:
        return None
    height, width = image_size
    is_central = abs(x_px / width - 0.5) < _OFF_CENTRE and abs(y_px / height - 0.5) < _OFF_CENTRE
    return focal_px if is_central else None


def _positive(value: Any) -> float | None:
    try:
        number = float(value)
    except (TypeError, ValueError, ArithmeticError):
        return None
    return number if math.isfinite(number) and number > 0 else None
