"""Read the subtitles that drones write beside a video: time, position, gimbal and height, block by block.

Layouts differ by model. Each is recognized by patterns of its own, in `_DIALECTS`; samples of most are in
the projects DJI_SRT_Parser and dji-drone-metadata-embedder on GitHub.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import TYPE_CHECKING, Literal, NamedTuple

from inspect_pipeline.geometry.attitude import Position, YawPitchRoll, position

if TYPE_CHECKING:
    from collections.abc import Sequence

    Order = Literal["latitude", "longitude"]  # which of the two comes first

_NUMBER = r"([+-]?\d+(?:\.\d+)?)"
_SPAN = re.compile(r"(\d+):(\d\d):(\d\d)[,.](\d{3})\s*-->.*")
_CLOCK = re.compile(r"(\d{4})[-.](\d\d?)[-.](\d\d?)\s+(\d\d?):(\d\d):(\d\d)(?:[.,](\d{3}))?")
_FIELD = re.compile(rf"(\w+)\s*:\s*{_NUMBER}")
_GPS = re.compile(rf"GPS\s*\({_NUMBER},\s*{_NUMBER},\s*{_NUMBER}(\w*)\)")
_HOME = re.compile(rf"HOME\s*\({_NUMBER},\s*{_NUMBER}")
_LETTERED_GPS = re.compile(rf"GPS\s*\(([EW]):\s*{_NUMBER},\s*([NS]):\s*{_NUMBER}(?:,\s*{_NUMBER}m)?")
_FOCAL = re.compile(rf"\bfocal_len\s*:\s*{_NUMBER}")
_ZOOM = re.compile(rf"\bdzoom_ratio\s*:\s*{_NUMBER}")
_LEAST_TENTHS = 100  # no drone has a lens below 10 mm
_MOST_FOCAL, _MOST_ZOOM = 100_000, 1000  # anything beyond is damage
_ZOOM_UNIT, _LEAST_ZOOM_UNITS = 10_000, 1000  # dzoom_ratio: 10000 is no zoom, as is 1.00
_HEIGHT = re.compile(rf"(?:\brel_alt:\s*|\bBAROMETER\s*[:(]\s*|\bHb:\s*|\bH\s+){_NUMBER}")
_GIMBAL = re.compile(rf"\bG\.PRY\s*\({_NUMBER}°?,\s*{_NUMBER}°?,\s*{_NUMBER}°?\)")  # pitch, roll, yaw


class _Dialect(NamedTuple):
    """A layout of GPS(a, b, c): its mark, and which coordinate comes first; None where that varies."""

    models: str
    mark: re.Pattern[str]
    first: Order | None


_DIALECTS = (
    _Dialect("Avata 2, Neo", re.compile(r"BAROMETER\s*\("), "latitude"),
    _Dialect("Matrice 300", re.compile(r"BAROMETER\s*:\s*[-\d.]+M"), "latitude"),
    _Dialect("Mavic Pro", re.compile(r"BAROMETER\s*:"), "longitude"),
    _Dialect("Phantom 3", re.compile(r"\bHb\s*:"), "longitude"),
    _Dialect("Phantom 4, Phantom 4 RTK", re.compile(r"[FG]\.PRY|\bF/\d"), "longitude"),
    _Dialect("others", re.compile(""), None),
)


@dataclass(frozen=True, slots=True)
class SubtitleBlock:
    """One block.

    offset_ns: from the start of the video. clock: the drone's own, without a time zone. height_m: above
    take-off. focal_35mm: focal length for 35 mm film, times the digital zoom.
    """

    offset_ns: int
    clock: datetime | None
    position: Position | None
    gimbal: YawPitchRoll | None
    height_m: float | None
    focal_35mm: float | None


class Subtitles(NamedTuple):
    """The blocks of a file, and why they have no positions, None where they have."""

    blocks: Sequence[SubtitleBlock]
    problem: str | None


def parse_srt(text: str) -> Subtitles:
    """Parse a subtitle file; anything that is no block is skipped."""
    parts = [part for part in re.split(r"\n\s*\n", text.replace("\r\n", "\n")) if _SPAN.search(part)]
    proven = _proven_order(text)
    blocks = [_parse_block(part, proven) for part in parts]
    if any(block.position for block in blocks):
        return Subtitles(blocks, None)
    if not parts:
        return Subtitles(blocks, "it has no blocks with times")
    if proven is None and any(_is_ambiguous(part) for part in parts):
        return Subtitles(blocks, "whether latitude or longitude comes first is not clear")
    return Subtitles(blocks, "it has no positions in a known layout")


def _parse_block(block: str, proven: Order | None) -> SubtitleBlock:
    span = _SPAN.search(block)
    assert span is not None  # noqa: S101 - blocks without were skipped
    hours, minutes, seconds, milliseconds = map(int, span.groups())
    offset = timedelta(hours=hours, minutes=minutes, seconds=seconds, milliseconds=milliseconds)
    body = block[span.end() :]
    fields = {name: float(value) for name, value in _FIELD.findall(body)}
    height = _HEIGHT.search(body)
    return SubtitleBlock(
        offset_ns=offset // timedelta(microseconds=1) * 1000,
        clock=_clock(body),
        position=_position(body, fields, proven),
        gimbal=_gimbal(body, fields),
        height_m=float(height[1]) if height else None,
        focal_35mm=_focal_35mm(body),
    )


def _clock(body: str) -> datetime | None:
    match = _CLOCK.search(body)
    if match is None:
        return None
    year, month, day, hour, minute, second = map(int, match.groups()[:6])
    try:
        return datetime(year, month, day, hour, minute, second, int(match[7] or 0) * 1000)
    except ValueError:
        return None


def _position(body: str, fields: dict[str, float], proven: Order | None) -> Position | None:
    """Return the position by named fields (Mavic 2 spells longtitude), by letters, or by a known order."""
    longitude_deg = fields.get("longitude", fields.get("longtitude"))
    if "latitude" in fields and longitude_deg is not None:
        altitude_m = fields.get("abs_alt", fields.get("altitude", math.nan))
        return position(fields["latitude"], longitude_deg, altitude_m)
    if match := _LETTERED_GPS.search(body):  # Autel
        latitude_deg, longitude_deg = float(match[4]), float(match[2])
        return position(
            -latitude_deg if match[3] == "S" else latitude_deg,
            -longitude_deg if match[1] == "W" else longitude_deg,
            float(match[5] or "nan"),
        )
    match = _GPS.search(body)
    order = _dialect(body).first or proven
    if match is None or order is None:
        return None
    first, second = float(match[1]), float(match[2])
    # The third is a count of satellites, or an accuracy with a unit; an altitude has a fraction and no unit.
    altitude_m = float(match[3]) if "." in match[3] and not match[4] else math.nan
    return position(*((first, second) if order == "latitude" else (second, first)), altitude_m)


def _dialect(body: str) -> _Dialect:
    return next(dialect for dialect in _DIALECTS if dialect.mark.search(body))


def _is_ambiguous(body: str) -> bool:
    return _GPS.search(body) is not None and _dialect(body).first is None


def _proven_order(text: str) -> Order | None:
    """Return the order that the numbers of GPS and HOME prove: latitudes end at 90 degrees."""
    pairs = [match.groups()[:2] for pattern in (_GPS, _HOME) for match in pattern.finditer(text)]
    firsts, seconds = (max((abs(float(pair[i])) for pair in pairs), default=0.0) for i in (0, 1))
    if (firsts > 90) == (seconds > 90):
        return None
    return "longitude" if firsts > 90 else "latitude"


def _gimbal(body: str, fields: dict[str, float]) -> YawPitchRoll | None:
    if match := _GIMBAL.search(body):
        pitch_deg, roll_deg, yaw_deg = map(float, match.groups())
        return YawPitchRoll(yaw_deg, pitch_deg, roll_deg)
    turns = [fields.get(name) for name in ("gb_yaw", "gb_pitch", "gb_roll")]
    return YawPitchRoll(*(turn for turn in turns if turn is not None)) if None not in turns else None


def _focal_35mm(body: str) -> float | None:
    """Return the focal length: with a fraction in mm, without in tenths of them (240 is 24 mm)."""
    match = _FOCAL.search(body)
    if match is None or not 0 < float(match[1]) < _MOST_FOCAL:
        return None
    focal_mm = float(match[1]) / (10 if "." not in match[1] and float(match[1]) >= _LEAST_TENTHS else 1)
    zoom = _ZOOM.search(body)
    ratio = float(zoom[1]) if zoom else 1.0
    ratio = min(ratio / _ZOOM_UNIT if ratio >= _LEAST_ZOOM_UNITS else max(ratio, 1.0), _MOST_ZOOM)
    return focal_mm * ratio
