"""A progress bar on stderr where that is a terminal, nothing otherwise."""

from __future__ import annotations

import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Iterator


class Advance(Protocol):
    """Move the bar by one step, or to `completed`; change its text or its total."""

    def __call__(
        self, text: str | None = None, completed: int | None = None, total: int | None = None
    ) -> None: ...


@contextmanager
def progress_bar(name: str, total: int | None, done: int = 0) -> Iterator[Advance]:
    """Show a bar of `total` steps (None if unknown), the first `done` of them completed."""
    if not sys.stderr.isatty():
        yield lambda text=None, completed=None, total=None: None  # noqa: ARG005
        return
    from rich import progress
    from rich.console import Console

    columns = (
        progress.TextColumn("{task.description}", markup=False),  # file names can look like markup
        progress.BarColumn(),
        progress.MofNCompleteColumn(),
        progress.TimeRemainingColumn(),
    )
    with progress.Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(name, total=total, completed=done)

        def advance(text: str | None = None, completed: int | None = None, total: int | None = None) -> None:
            bar.update(task, description=text or name, completed=completed, total=total)
            if completed is None:
                bar.advance(task)

        yield advance
