"""A progress bar on stderr while a person is watching, nothing otherwise."""

from __future__ import annotations

import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Iterator


class Advance(Protocol):
    """Move the bar by one, or to `completed`, with words about where it is; `total` may be told late."""

    def __call__(
        self, words: str | None = None, completed: int | None = None, total: int | None = None
    ) -> None: ...


@contextmanager
def progress_bar(name: str, total: int | None, done: int = 0) -> Iterator[Advance]:
    """A bar of `total` steps, None while that is not known, `done` of which lie behind."""
    if not sys.stderr.isatty():
        yield lambda words=None, completed=None, total=None: None  # noqa: ARG005
        return
    from rich import progress
    from rich.console import Console

    columns = (
        progress.TextColumn("{task.description}", markup=False),  # names of files may look like markup
        progress.BarColumn(),
        progress.MofNCompleteColumn(),
        progress.TimeRemainingColumn(),
    )
    with progress.Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(name, total=total, completed=done)

        def advance(words: str | None = None, completed: int | None = None, total: int | None = None) -> None:
            bar.update(task, description=words or name, completed=completed, total=total)
            if completed is None:
                bar.advance(task)

        yield advance
