"""Images as photographs of a drone: JPEG with place, time and attitude in EXIF and the XMP of DJI."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any
from xml.sax.saxutils import quoteattr

from PIL import ExifTags, Image, TiffImagePlugin

from inspect_pipeline.atomic import appearing
from inspect_pipeline.resources import app_version

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from inspect_pipeline.arrays import ImageArray

    Row = Mapping[str, Any]

_QUALITY = 95
_FILM_DIAGONAL_MM = math.hypot(36, 24)
_SECOND_PARTS = 10**6  # of an arc second: below a tenth of a millimetre
_DJI = "http://www.dji.com/drone-dji/1.0/"
_ANGLES = {
    "GimbalYawDegree": "cam_yaw_deg",
    "GimbalPitchDegree": "cam_pitch_deg",
    "GimbalRollDegree": "cam_roll_deg",
    "FlightYawDegree": "heading_deg",
}


def write_photograph(path: Path, image: ImageArray, row: Row) -> None:
    """Write an RGB image with what a row of `frames` says of it; what is NULL is left out. Raises OSError."""
    exif = _to_exif(row, image.shape[:2])
    with appearing(path) as part:
        Image.fromarray(image).save(
            part, "JPEG", quality=_QUALITY, subsampling=0, exif=exif.tobytes(), xmp=_to_xmp(row)
        )


def _to_exif(row: Row, size: tuple[int, ...]) -> Image.Exif:
    time = datetime.fromtimestamp(row["log_time_ns"] // 10**9, UTC)
    exif = Image.Exif()
    exif[ExifTags.Base.Software] = f"lsnet-pipe {app_version()}"
    if row.get("reasons"):
        exif[ExifTags.Base.ImageDescription] = _ascii("; ".join(row["reasons"]))
    camera = exif.get_ifd(ExifTags.IFD.Exif)
    camera[ExifTags.Base.DateTimeOriginal] = f"{time:%Y:%m:%d %H:%M:%S}"
    camera[ExifTags.Base.OffsetTimeOriginal] = "+00:00"
    camera[ExifTags.Base.SubsecTimeOriginal] = f"{row['log_time_ns'] % 10**9 // 1000:06d}"
    if row["focal_px"]:
        film_mm = row["focal_px"] * _FILM_DIAGONAL_MM / math.hypot(*size)
        camera[ExifTags.Base.FocalLengthIn35mmFilm] = max(1, round(film_mm))
    if row["lat_deg"] is not None and row["lon_deg"] is not None:
        exif.get_ifd(ExifTags.IFD.GPSInfo).update(_gps(row, time))
    return exif


def _gps(row: Row, time: datetime) -> dict[int, Any]:
    tags = ExifTags.GPS
    gps: dict[int, Any] = {
        tags.GPSVersionID: b"\2\3\0\0",
        tags.GPSLatitudeRef: "N" if row["lat_deg"] >= 0 else "S",
        tags.GPSLatitude: _sexagesimal(row["lat_deg"]),
        tags.GPSLongitudeRef: "E" if row["lon_deg"] >= 0 else "W",
        tags.GPSLongitude: _sexagesimal(row["lon_deg"]),
        tags.GPSDateStamp: f"{time:%Y:%m:%d}",
        tags.GPSTimeStamp: (float(time.hour), float(time.minute), float(time.second)),
    }
    if row["alt_m"] is not None:
        gps[tags.GPSAltitudeRef] = b"\1" if row["alt_m"] < 0 else b"\0"
        gps[tags.GPSAltitude] = TiffImagePlugin.IFDRational(round(abs(row["alt_m"]) * 1000), 1000)
    if row["cam_yaw_deg"] is not None:
        gps[tags.GPSImgDirectionRef] = "T"
        gps[tags.GPSImgDirection] = TiffImagePlugin.IFDRational(round(row["cam_yaw_deg"] % 360 * 100), 100)
    return gps


def _sexagesimal(angle_deg: float) -> tuple[TiffImagePlugin.IFDRational, ...]:
    """Return degrees, minutes and seconds."""
    parts = round(abs(angle_deg) * 3600 * _SECOND_PARTS)
    minutes, seconds = divmod(parts, 60 * _SECOND_PARTS)
    ratio = TiffImagePlugin.IFDRational
    return ratio(minutes // 60, 1), ratio(minutes % 60, 1), ratio(seconds, _SECOND_PARTS)


def _to_xmp(row: Row) -> bytes:
    fields = {name: f"{row[column]:+.6f}" for name, column in _ANGLES.items() if row[column] is not None}
    heights = {"RelativeAltitude": "height_m", "AbsoluteAltitude": "alt_m"}
    fields |= {name: f"{row[column]:+.3f}" for name, column in heights.items() if row[column] is not None}
    attributes = " ".join(f"drone-dji:{name}={quoteattr(value)}" for name, value in fields.items())
    return (
        '<?xpacket begin="\ufeff" id="W5M0MpCehiHzreSzNTczkc9d"?>'
        '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
        f'<rdf:Description rdf:about="" xmlns:drone-dji="{_DJI}" {attributes}/>'
        '</rdf:RDF></x:xmpmeta><?xpacket end="w"?>'
    ).encode()


def _ascii(text: str) -> str:
    return text.encode("ascii", "replace").decode()
