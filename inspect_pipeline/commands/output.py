"""What commands print: results on stdout; warnings and errors, one line each, on stderr."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import typer

from inspect_pipeline.errors import InspectError, printable, shorten

if TYPE_CHECKING:
    from collections.abc import Sequence

# The option that helps, by the class of the error, its bases included: libraries do not know of options.
_OPTIONS = {
    "AnnotationChannelError": "--write none",
    "DamagedRecordingError": "without --strict",
    "EmptyResultError": "--yes replaces them",
    "ExecutorError": "--executor local",
    "HookError": "--on-finish CMD",
    "QueryTimeoutError": "--timeout SECONDS",
    "QueryValuesError": "--param NAME=VALUE",
    "StoreWriteError": "--store DIR",
}


def print_line(text: str) -> None:
    """Print a line of results; control characters in it, as of file names, become `?`."""
    typer.echo(printable(text))


def note(text: str) -> None:
    """Print what is good to know while a command runs."""
    _print_note(f"note: {text}")


def warn(text: str) -> None:
    """Print a warning."""
    _print_note(f"warning: {text}")


def report_error(error: Exception, subject: object = None) -> int | None:
    """Print an error that users can meet, with the option that helps.

    Args:
        error: any exception.
        subject: what was worked on, named where an OSError does not name its file.

    Returns:
        The exit code, or None for a fault of the program, of which nothing is printed.
    """
    message = _describe(error, subject)
    if message is None:
        return None
    options = [_OPTIONS[kind.__name__] for kind in type(error).__mro__ if kind.__name__ in _OPTIONS]
    hint = f" ({options[0]})" if options else ""
    _print_note(f"error: {shorten(message)}{hint}")
    return getattr(error, "exit_code", 1)


def _print_note(text: str) -> None:
    typer.echo(shorten(printable(text)), err=True)


def report_usage(error: Exception) -> int | None:
    """Print what is wrong with the arguments of a command; None for any other error."""
    show, exit_code = getattr(error, "show", None), getattr(error, "exit_code", None)
    if isinstance(error, InspectError) or show is None or exit_code is None:
        return None
    show()  # typer's own errors, which are of click or of a copy of it, by version
    return int(exit_code)


def _describe(error: Exception, subject: object) -> str | None:
    # lsnet is slow to import; where it has not been, none of its errors was raised.
    detector_error = getattr(sys.modules.get("lsnet"), "LSNetError", InspectError)
    if isinstance(error, (InspectError, detector_error)):
        return str(error)
    if isinstance(error, OSError):  # what no library expects: a disk that fails, permissions that change
        name = subject or error.filename or "system"
        return f"{name}: {error.strerror or error}; check the disk and the permissions"
    return None


def print_table(headers: Sequence[str], rows: Sequence[Sequence[object]], empty: str) -> None:
    """Print rows in columns under headers; numbers to the right, the last column as it comes.

    Args:
        headers: one for each column.
        rows: cells; None is shown as `-`.
        empty: the line printed instead when there are no rows.
    """
    if not rows:
        typer.echo(empty)
        return
    texts = [["-" if cell is None else printable(str(cell)) for cell in row] for row in rows]
    widths = [max(map(len, column)) for column in zip(headers, *texts, strict=True)]
    to_right = [
        all(isinstance(cell, int | float) or cell is None for cell in column)
        for column in zip(*rows, strict=True)
    ]
    for line in (headers, *texts):
        cells = (
            cell.rjust(width) if right else cell.ljust(width)
            for cell, width, right in zip(line, widths, to_right, strict=True)
        )
        typer.echo("  ".join(cells).rstrip())


def message_of(detail: str, path: str) -> str:
    """Return the message of a failure, which ends a traceback, without the path, which stands beside it."""
    lines = detail.strip().splitlines() or [""]
    return lines[-1].removeprefix(f"{printable(path)}: ")
