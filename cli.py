"""The command line: mounts the commands of inspect_pipeline, and turns every error into one line."""

from __future__ import annotations

import signal
import sys
from importlib.metadata import version
from io import TextIOWrapper
from typing import TYPE_CHECKING, Annotated

import typer

from inspect_pipeline.commands import (
    anomalies,
    batch,
    check,
    detect,
    doctor,
    flights,
    index,
    info,
    model,
    overlay,
    pack,
    process,
    quarantine,
    query,
    runs,
    schedule,
    simulate,
    spans,
)
from inspect_pipeline.commands.batch_log import printable
from inspect_pipeline.errors import InspectError

if TYPE_CHECKING:
    from types import FrameType

app = typer.Typer(
    name="lsnet-pipe",
    help="Find power lines in MCAP recordings, write them back as annotations, ask for them in SQL.",
    epilog="Example: lsnet-pipe process flight.mcap",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
app.command()(process.process)
app.command()(batch.batch)
app.command()(query.query)
app.command()(check.check)
app.command()(info.info)
app.command()(detect.detect)
app.command()(overlay.overlay)
app.command()(pack.pack)
app.command()(simulate.simulate)
app.command()(doctor.doctor)
app.command()(schedule.schedule)
app.command()(runs.runs)
app.add_typer(flights.app, name="flights")
app.add_typer(anomalies.app, name="anomalies")
app.add_typer(spans.app, name="spans")
app.add_typer(index.app, name="index")
app.add_typer(model.app, name="model")
app.add_typer(quarantine.app, name="quarantine")


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"lsnet-pipe {version('lsnet-pipe')}")
        raise typer.Exit


@app.callback()
def _before_command(
    _version: Annotated[
        bool,
        typer.Option("--version", callback=_print_version, is_eager=True, help="Show the version and exit."),
    ] = False,
) -> None:
    pass


def main() -> None:
    """Run the command line; the exit code is that of the error or the signal that ended it."""
    received: list[int] = []

    def stop(signal_number: int, _frame: FrameType | None) -> None:
        """End as after an error: what was begun is cleaned up on the way out."""
        received.append(signal_number)
        sys.exit(128 + signal_number)

    for signal_number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(signal_number, stop)
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # names of files need be no text
    try:
        app()
    except Exception as error:
        if received:  # DuckDB answers a stop amid a statement with an error of its own
            sys.exit(128 + received[0])
        message = _to_message(error)
        if message is None:
            raise
        typer.echo(printable(f"error: {message}"), err=True)
        sys.exit(getattr(error, "exit_code", 1))


def _to_message(error: Exception) -> str | None:
    """The line for an error that users can meet; None for a fault of the program."""
    # lsnet is slow to import, and not needed to tell an error that it has not raised.
    detector_error = getattr(sys.modules.get("lsnet"), "LSNetError", InspectError)
    if isinstance(error, (InspectError, detector_error)):
        return str(error)
    if isinstance(error, OSError):  # what no command expects: a disk that fails, rights that change
        return f"{error.filename or 'system'}: {error.strerror or error}; check the disk and its rights"
    return None


if __name__ == "__main__":
    main()
