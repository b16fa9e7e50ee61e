"""`lsnet-pipe schedule`."""

from __future__ import annotations

import sys
from datetime import datetime
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from inspect_pipeline.commands.options import InboxArgument, StoreOption


class Scheduler(StrEnum):
    """Values of `--print`."""

    systemd = "systemd"
    cron = "cron"


def schedule(
    inbox: InboxArgument,
    scheduler: Annotated[Scheduler, typer.Option("--print", help="The scheduler to configure.")],
    store: StoreOption = None,
    config: Annotated[
        Path | None, typer.Option(metavar="FILE", help="File with more options of `batch`.")
    ] = None,
    at: Annotated[
        datetime, typer.Option(formats=["%H:%M"], metavar="HH:MM", help="Start time, local.")
    ] = "01:30",  # type: ignore[assignment]  # Typer parses it
    user: Annotated[str | None, typer.Option(metavar="NAME", help="User of the systemd service.")] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="DIR", help="Write the units there instead of printing them."),
    ] = None,
) -> None:
    """Print systemd units or a crontab line for `batch`.

    \b
    Examples:
      lsnet-pipe schedule /data/inbox --store /data/store --print systemd
      lsnet-pipe schedule /data/inbox --print cron --at 02:00
    """
    if scheduler is Scheduler.cron and (user or output):
        raise typer.BadParameter("--user and -o go with --print systemd")

    from inspect_pipeline.batch.schedule import cron_line, systemd_units
    from inspect_pipeline.errors import OutputError
    from inspect_pipeline.store.store import store_path

    folder = store_path(store).absolute()
    program = str(Path(sys.executable).with_name("lsnet-pipe"))
    options = ["--config", str(config.absolute())] if config else []
    # A timer has another current directory than this command.
    inboxes = [str(Path(name).absolute()) for name in inbox]
    command = [program, "batch", *inboxes, "--store", str(folder), *options]
    if any(not each.isprintable() for each in (*command, user or "")):  # a newline would add a directive
        raise typer.BadParameter("names with control characters cannot be scheduled")
    if scheduler is Scheduler.cron:
        try:
            typer.echo(cron_line(command, at.time()), nl=False)
        except ValueError as error:
            raise typer.BadParameter(str(error)) from error
        return
    try:
        units = systemd_units(command, folder, at.time(), user)
    except ValueError as error:
        raise typer.BadParameter(str(error)) from error
    for suffix, text in units._asdict().items():
        name = f"lsnet-pipe.{suffix}"
        if output is None:
            typer.echo(f"# {name}\n{text}")
            continue
        try:
            (output / name).write_text(text, encoding="utf-8")
        except OSError as error:
            problem = f"cannot be written ({error.strerror})"
            raise OutputError(output / name, problem, "name another folder") from error
