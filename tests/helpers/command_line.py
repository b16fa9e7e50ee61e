"""The program in this process: what a command leaves."""

from __future__ import annotations

import signal
import sys
from typing import TYPE_CHECKING, NamedTuple

import pytest
import typer

import cli

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    import click


def all_commands() -> list[str]:
    """Return the names of the program, its groups and their commands, as in "spans import"."""

    def names(command: click.Command, prefix: str) -> Iterator[str]:
        yield prefix
        for name, child in getattr(command, "commands", {}).items():
            yield from names(child, f"{prefix} {name}".strip())

    return list(names(typer.main.get_command(cli.app), ""))


class Outcome(NamedTuple):
    """What a command left: exit code, stdout and stderr."""

    exit_code: int
    out: str
    err: str


def runner(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Callable[..., Outcome]:
    """What runs `lsnet-pipe ARGUMENTS`, without its signal handlers."""
    monkeypatch.setattr(signal, "signal", lambda number, handler: signal.SIG_DFL)

    def run(*arguments: object) -> Outcome:
        monkeypatch.setattr(sys, "argv", ["lsnet-pipe", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        captured = capfd.readouterr()
        return Outcome(int(ended.value.code or 0), captured.out, captured.err)

    return run
