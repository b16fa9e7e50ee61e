"""Decisions about anomalies, and the index brought up to date with them."""

from __future__ import annotations

import getpass
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING, Any, Self

from inspect_pipeline.index.anomalies import find_anomaly
from inspect_pipeline.publishing import publish
from inspect_pipeline.store.feedback import add_review

if TYPE_CHECKING:
    from types import TracebackType

    from inspect_pipeline.store.feedback import Review, Verdict
    from inspect_pipeline.store.store import Store


def decide(
    store: Store, beginning: str, verdict: Verdict, note: str, reviewed_by: str | None = None
) -> Review:
    """Record a decision about the anomaly whose id begins so; by default the user of this process decides.

    Raises UnknownIdError, AmbiguousIdError, StoreError.
    """
    return add_review(store, find_anomaly(store, beginning), verdict, note, reviewed_by or user_name())


def user_name() -> str:
    """Return the name of the user of this process, empty where it has none."""
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # a user id without a name, as in containers
        return ""


class Publisher:
    """Publishes a store in the background: decisions made meanwhile wait for the next publish together."""

    def __init__(self, store: Store) -> None:
        self._store, self._pool = store, ThreadPoolExecutor(1)
        self._last: Future[Any] | None = None

    def request(self) -> None:
        """Publish soon."""
        if self._last is None or self._last.running() or self._last.done():
            self._last = self._pool.submit(publish, self._store)

    def wait(self) -> None:
        """Wait until everything requested is published. Raises StoreError."""
        if self._last is not None:
            self._last.result()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, _kind: type[BaseException] | None, _error: BaseException | None, _trace: TracebackType | None
    ) -> None:
        self._pool.shutdown()
