"""Texts that make a batch run every night: a systemd service with its timer, or a line for cron."""

from __future__ import annotations

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
    """Units that run a command at a time of day, able to write nothing but the store."""
    words = " ".join(_quote_for_systemd(word).replace("$", "$$") for word in command)
    service = _SERVICE.format(
        command=words, store=_quote_for_systemd(str(store)), user=f"User={user}\n" if user else ""
    )
    return SystemdUnits(service, _TIMER.format(at=at))


def cron_line(command: Sequence[str], at: time) -> str:
    """A line of a crontab; raises ValueError for words with line ends, which cron cannot have."""
    words = shlex.join(command)
    if "\n" in words:
        raise ValueError("cron takes no names with line ends")
    plain = words.replace("%", r"\%")
    return f"{at.minute} {at.hour} * * * nice -n 10 {plain}\n"


def _quote_for_systemd(word: str) -> str:
    """A word in double quotes, with what systemd would expand or unescape made plain."""
    escapes = {"\\": "\\\\", '"': '\\"', "\n": "\\n", "%": "%%"}
    return '"' + "".join(escapes.get(c, c) for c in word) + '"'
