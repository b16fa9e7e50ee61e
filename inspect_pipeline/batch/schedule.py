"""Schedules of a nightly batch: a systemd service with its timer, or a line for cron."""

from __future__ import annotations

import re
import shlex
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Sequence
    from datetime import time
    from pathlib import Path

# 3 is a success with something to look at: quarantined recordings. The batch itself stops on SIGTERM, within
# seconds; its workers are left to it.
_SERVICE = """\
[Unit]
Description=Process new inspection recordings
Wants=network-online.target
After=network-online.target

[Service]
Type=oneshot
ExecStart={command}
SuccessExitStatus=3
TimeoutStartSec=6h
TimeoutStopSec=90
KillMode=mixed
Nice=10
IOSchedulingClass=idle
ProtectSystem=strict
ProtectHome=read-only
PrivateTmp=true
NoNewPrivileges=true
ReadWritePaths={store}
{user}"""
_TIMER = """\
[Unit]
Description=Process new inspection recordings every night

[Timer]
OnCalendar=*-*-* {at:%H:%M}:00
Persistent=true
RandomizedDelaySec=5min
FixedRandomDelay=true

[Install]
WantedBy=timers.target
"""


class SystemdUnits(NamedTuple):
    """The contents of lsnet-pipe.service and lsnet-pipe.timer."""

    service: str
    timer: str


def systemd_units(command: Sequence[str], store: Path, at: time, user: str | None) -> SystemdUnits:
    """Return units that run a command at a time of day and may write nothing but the store.

    Raises ValueError for a user name that systemd does not take, such as one with a line end.
    """
    if user is not None and not re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_.-]*\$?", user):
        raise ValueError(f"{user!r} is no user name")
    words = " ".join(_quote_for_systemd(word).replace("$", "$$") for word in command)
    service = _SERVICE.format(
        command=words, store=_quote_for_systemd(str(store)), user=f"User={user}\n" if user else ""
    )
    return SystemdUnits(service, _TIMER.format(at=at))


def cron_line(command: Sequence[str], at: time) -> str:
    """Return a line of a crontab; raises ValueError for arguments with line ends, which cron cannot have."""
    words = shlex.join(command)
    if "\n" in words:
        raise ValueError("cron takes no names with line ends")
    plain = words.replace("%", r"\%")
    return f"{at.minute} {at.hour} * * * nice -n 10 {plain}\n"


def _quote_for_systemd(word: str) -> str:
    """Quote an argument, escaping what systemd would expand."""
    escapes = {"\\": "\\\\", '"': '\\"', "\n": "\\n", "%": "%%"}
    return '"' + "".join(escapes.get(c, c) for c in word) + '"'
