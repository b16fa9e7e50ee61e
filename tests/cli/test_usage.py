"""Help, and wrong usage, which exits with 2."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import pytest
from command_line import all_commands

if TYPE_CHECKING:
    from collections.abc import Callable

    from command_line import Outcome


@pytest.mark.parametrize(
    "arguments",
    [
        ["process"],
        ["proces", "a.mcap"],
        ["process", "a.mcap", "--every", "0"],
        ["process", "a.mcap", "--start", "yesterday"],
        ["process", "a.mcap", "--start", "20", "--end", "20"],
        ["process", "a.mcap", "--ground-alt", "nan"],
        ["process", "a.mcap", "--scale", "nan"],
        ["simulate", "a.mcap", "--size", "big"],
        ["simulate", "a.mcap", "--size", "100000x100000"],
        ["simulate", "a.mcap", "--fps", "inf"],
        ["simulate", "a.mcap", "--corner", "nan"],
        ["simulate", "a.mcap", "--hills", "-1"],
        ["simulate", "a.mcap", "--terrain", "hills.tif"],
        ["simulate", "a.mcap", "--fault", "gremlins"],
        ["query", "SELECT 1", "--format", "xml"],
        ["query", "SELECT 1", "--timeout", "inf"],
        ["query", "SELECT 1", "--show-sql"],
        ["query", "--named", "gaps", "--param", "flight"],
        ["schedule", "inbox", "--print", "cron", "-o", "units"],
        ["schedule", "inbox", "--print", "systemd", "--user", "kim\nExecStart=rm"],
        ["overlay", "ab", "-o", "o.txt"],
        ["overlay", "-o", "o.png"],
        ["overlay", "ab", "--anomaly", "cd", "-o", "o.png"],
        ["pack", "inbox", "o.mp4"],
        ["simulate", "o.bag"],
        ["query", "SELECT 1", "-o", "o.xml"],
        ["query", "SELECT 1", "-o", "o.csv", "--format", "json"],
        ["query", "SELECT 1", "--named", "flights"],
        ["query", "-f", "none.sql"],
        ["query", " "],
        ["query", "spans"],
        ["query", "SELECT 1", "-o", ""],
        ["overlay", "last", "-o", ""],
        ["flights", "list", "--store", ""],
        ["model", "ablate", "photos", "--run", "r", "--thinner", "3"],
        ["flights", "list", "--timezone", "Mars/Olympus"],
    ],
)
def test_wrong_usage_exits_2_in_plain_text(run: Callable[..., Outcome], arguments: list[str]) -> None:
    outcome = run(*arguments)
    assert (outcome.exit_code, outcome.out) == (2, "")
    assert "Error: " in outcome.err
    assert outcome.err.isascii()


@pytest.mark.parametrize("command", all_commands())
def test_help_has_an_example(run: Callable[..., Outcome], command: str) -> None:
    outcome = run(*command.split(), "--help")
    assert (outcome.exit_code, outcome.err) == (0, "")
    assert re.search(rf"^(  Example: |    )lsnet-pipe {command}", outcome.out, re.MULTILINE)
    assert not re.search(r"\w\.\.\.$", outcome.out, re.MULTILINE)  # no sentence is cut
    assert run(*command.split(), "-h").out == outcome.out
    assert outcome.out.isascii()


def test_version(run: Callable[..., Outcome]) -> None:
    assert run("--version").out.startswith("lsnet-pipe 0.")
