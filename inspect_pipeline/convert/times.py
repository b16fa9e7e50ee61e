"""Times of cameras' clocks in UTC."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta, timezone, tzinfo
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

_MICROSECOND = timedelta(microseconds=1)
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def parse_zone(text: str) -> tzinfo:
    """Parse a time zone such as Europe/Berlin, +02:00 or UTC. Raises ValueError."""
    if text[:1] in {"+", "-"}:
        offset = datetime.strptime(text, "%z").utcoffset()
        return timezone(offset or timedelta())
    try:
        return ZoneInfo(text)
    except (ZoneInfoNotFoundError, ValueError, OSError) as error:
        raise ValueError(f"{text!r} is no time zone") from error


def to_ns(clock: datetime, zone: tzinfo | timedelta) -> int:
    """Return integer nanoseconds since 1970 of a clock.

    `zone`, or its offset from UTC, counts where the clock has none of its own. Clocks that were never set
    may stand in the year 1.
    """
    offset = clock.utcoffset()
    if offset is None:
        offset = zone if isinstance(zone, timedelta) else zone.utcoffset(clock) or timedelta()
    return (clock.replace(tzinfo=UTC) - _EPOCH - offset) // _MICROSECOND * 1000
