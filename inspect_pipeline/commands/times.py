"""Times as commands print them: ISO 8601, in UTC with a Z or in the zone of `--timezone`."""

from __future__ import annotations

from datetime import UTC, datetime, tzinfo
from typing import Annotated
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

import typer


def _parse_zone(name: str) -> tzinfo:
    try:
        return ZoneInfo(name) if name.upper() not in {"UTC", "Z"} else UTC
    except (ZoneInfoNotFoundError, ValueError, OSError):
        raise typer.BadParameter(f"{name!r} is not a time zone like Europe/Zurich") from None


TimezoneOption = Annotated[
    tzinfo | None,
    typer.Option(
        "--timezone",
        envvar="LSNET_PIPE_TIMEZONE",
        parser=_parse_zone,
        metavar="ZONE",
        help="Time zone of printed times, like Europe/Zurich. Default: UTC.",
    ),
]


def format_time(time: datetime | str | None, zone: tzinfo | None = None) -> str | None:
    """Return a time to the second, as 2026-05-04T09:30:00Z or 2026-05-04T11:30:00+02:00.

    Args:
        time: a datetime or an ISO 8601 text; in UTC where it has no zone. None stays None.
        zone: the zone to show it in; UTC by default.
    """
    if time is None:
        return None
    parsed = datetime.fromisoformat(time) if isinstance(time, str) else time
    aware = parsed if parsed.tzinfo else parsed.replace(tzinfo=UTC)
    return aware.astimezone(zone or UTC).isoformat(timespec="seconds").replace("+00:00", "Z")
