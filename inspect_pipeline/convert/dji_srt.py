"""The subtitles that DJI's drones write beside a video: when, where and which way, block by block."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING

from inspect_pipeline.geometry.attitude import Position, YawPitchRoll, position

if TYPE_CHECKING:
    from collections.abc import Iterator

_SPAN = re.compile(r"(\d+):(\d\d):(\d\d)[,.](\d{3})\s*-->")
_CLOCK = re.compile(r"(\d{4})[-.](\d\d)[-.](\d\d) (\d\d):(\d\d):(\d\d)(?:[.,](\d{3}))?")
_FIELD = re.compile(r"(\w+)\s*:\s*([+-]?\d+(?:\.\d+)?)")
_GPS = re.compile(r"GPS\s*\(([-\d.]+),\s*([-\d.]+),\s*([-\d.]+)\w*\)")  # longitude, latitude, altitude


@dataclass(frozen=True, slots=True)
class SubtitleBlock:
    """One block: offset_ns counts from the start of the video, clock is the drone's own, taken for UTC.

    height_m is above take-off.
    """

    offset_ns: int
    clock: datetime | None
    position: Position | None
    gimbal: YawPitchRoll | None
    height_m: float | None


def parse_srt(text: str) -> Iterator[SubtitleBlock]:
    """The blocks of a subtitle file; what is none is passed over."""
    for block in re.split(r"\n\s*\n", text.replace("\r\n", "\n")):
        span = _SPAN.search(block)
        if span is None:
            continue
        hours, minutes, seconds, milliseconds = map(int, span.groups())
        offset = timedelta(hours=hours, minutes=minutes, seconds=seconds, milliseconds=milliseconds)
        fields = {name: float(value) for name, value in _FIELD.findall(block[span.end() :])}
        yield SubtitleBlock(
            offset_ns=offset // timedelta(microseconds=1) * 1000,
            clock=_clock(block),
            position=_position(block, fields),
            gimbal=_gimbal(fields),
            height_m=fields.get("rel_alt"),
        )


def _clock(block: str) -> datetime | None:
    match = _CLOCK.search(block)
    if match is None:
        return None
    year, month, day, hour, minute, second = map(int, match.groups()[:6])
    try:
        return datetime(year, month, day, hour, minute, second, int(match[7] or 0) * 1000, tzinfo=UTC)
    except ValueError:
        return None


def _position(block: str, fields: dict[str, float]) -> Position | None:
    """Mavic 2 spells it longtitude; models before it write GPS(longitude, latitude, altitude)."""
    longitude_deg = fields.get("longitude", fields.get("longtitude"))
    if "latitude" in fields and longitude_deg is not None:
        altitude_m = fields.get("abs_alt", fields.get("altitude", math.nan))
        return position(fields["latitude"], longitude_deg, altitude_m)
    match = _GPS.search(block)
    return position(float(match[2]), float(match[1]), float(match[3])) if match else None


def _gimbal(fields: dict[str, float]) -> YawPitchRoll | None:
    turns = [fields.get(name) for name in ("gb_yaw", "gb_pitch", "gb_roll")]
    return YawPitchRoll(*(turn for turn in turns if turn is not None)) if None not in turns else None
