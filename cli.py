"""The command line: mounts the commands of inspect_pipeline, and reports every error in one line."""

from __future__ import annotations

import os
import sys
from importlib.metadata import version
from io import TextIOWrapper
from itertools import pairwise
from typing import Annotated

import typer

from inspect_pipeline.commands import (
    anomalies,
    batch,
    check,
    compare,
    detect,
    doctor,
    export,
    flights,
    index,
    info,
    model,
    overlay,
    pack,
    process,
    quarantine,
    query,
    report,
    review,
    runs,
    schedule,
    simulate,
    spans,
    view,
)
from inspect_pipeline.commands.interrupts import exit_if_stopped, install_handlers
from inspect_pipeline.commands.output import report_error, report_usage

app = typer.Typer(
    name="lsnet-pipe",
    help="Find power lines in MCAP recordings, write them back as annotations, and query them in SQL.",
    epilog="Example: lsnet-pipe process flight.mcap",
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
app.command()(process.process)
app.command()(batch.batch)
app.command()(query.query)
app.command()(check.check)
app.command()(compare.compare)
app.command()(info.info)
app.command()(detect.detect)
app.command()(overlay.overlay)
app.command()(export.export)
app.command()(view.view)
app.command()(report.report)
app.command()(review.review)
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


_NAMING = ("-o", "--output", "--store", "--draw", "--map", "--metrics")


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
    for option, value in pairwise(sys.argv[1:]):
        if (
            option in _NAMING and not value
        ):  # as an unset variable of a shell; a Path would be the current folder
            raise typer.BadParameter(f"{option} is given an empty name")


def main() -> None:
    """Run the command line and exit with the code of the error or the signal that ended it."""
    install_handlers()
    if sys.stdout is None:  # as after `>&-`
        sys.exit("error: stdout is closed; redirect it to a file or to /dev/null")
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # file names need not be text
    try:
        exit_code = app(prog_name="lsnet-pipe", standalone_mode=False)
        sys.stdout.flush()
    except SystemExit as stop:
        # Typer exits with 1 after a BrokenPipeError: the reader of stdout has seen enough, as in `| head`.
        exit_code = 0 if isinstance(stop.__context__, BrokenPipeError) else stop.code
    except BrokenPipeError:
        exit_code = 0
        _discard_stdout()
    except Exception as error:
        exit_if_stopped()  # DuckDB turns a stop during a statement into an error of its own
        exit_code = report_usage(error) or report_error(error)
        if exit_code is None:
            raise
        if isinstance(error, OSError):  # perhaps of stdout, which would fail again
            _discard_stdout()
    exit_if_stopped()
    sys.exit(exit_code)


def _discard_stdout() -> None:
    """Send what is left in the buffer nowhere: Python flushes it at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


if __name__ == "__main__":
    main()
