"""What is printed for systemd and cron, as they understand it."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
from datetime import time
from pathlib import Path

import pytest

from inspect_pipeline.batch.schedule import cron_line, systemd_units

COMMAND = ["/bin/echo", "batch", "/data/in box", "50%", "$HOME", 'a"b', "it's", "żółć", "/data/2026-*"]


def test_systemd_accepts_the_units(tmp_path: Path) -> None:
    if not shutil.which("systemd-analyze"):
        pytest.skip("systemd-analyze is not installed")
    units = systemd_units(COMMAND, tmp_path / "the store", time(1, 30), "daemon")
    paths = [tmp_path / "lsnet-pipe.service", tmp_path / "lsnet-pipe.timer"]
    for path, text in zip(paths, units, strict=True):
        path.write_text(text)
    verified = subprocess.run(
        ["systemd-analyze", "verify", *paths], capture_output=True, text=True, check=False
    )
    assert (verified.returncode, verified.stderr) == (0, "")


def test_what_systemd_would_expand_is_escaped(tmp_path: Path) -> None:
    service = systemd_units(COMMAND, Path("/data/100%"), time(1, 30), None).service
    assert '"50%%" "$$HOME" "a\\"b" "it\'s"' in service
    assert 'ReadWritePaths="/data/100%%"\n' in service
    assert "User=" not in service


@pytest.mark.parametrize("user", ["daemon\nExecStartPre=/bin/rm", "a b", "", "%u", "-x", "a;b"])
def test_a_user_adds_no_directive(tmp_path: Path, user: str) -> None:
    with pytest.raises(ValueError, match="no user name"):
        systemd_units(COMMAND, tmp_path, time(1), user)


def test_the_line_of_cron() -> None:
    line = cron_line(COMMAND, time(4, 5))
    minute, hour, *days, command = line.rstrip("\n").split(" ", 5)
    assert (minute, hour, days) == ("5", "4", ["*", "*", "*"])
    assert shlex.split(command.replace(r"\%", "%")) == ["nice", "-n", "10", *COMMAND]
    ran = subprocess.run(
        ["/bin/sh", "-c", command.replace(r"\%", "%")], capture_output=True, check=True, env=os.environ
    )
    assert ran.stdout.decode().split() == " ".join(COMMAND[1:]).split()
    with pytest.raises(ValueError, match="line ends"):
        cron_line(["a\nb"], time(1))
