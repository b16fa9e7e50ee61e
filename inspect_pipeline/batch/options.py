"""Options of a batch, and the executor that they ask for."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from inspect_pipeline.batch.local import LocalExecutor
from inspect_pipeline.batch.ray import RayExecutor

if TYPE_CHECKING:
    from collections.abc import Mapping

    from inspect_pipeline.batch.executor import Executor
    from inspect_pipeline.batch.stop_request import StopRequest
    from inspect_pipeline.batch.worker import Job
    from inspect_pipeline.config import ExecutorName


@dataclass(frozen=True, slots=True)
class BatchOptions:
    """Options of a batch.

    Attributes:
        inboxes: Folders, files and glob patterns.
        since_ns: Only files changed since, ns since 1970.
        limit: Maximum number of recordings to process.
        executor: Where the workers run.
        n_workers: Recordings processed at a time.
        timeout_s: Time limit of one attempt at a recording.
        max_attempts: Attempts before a recording that fails them goes to quarantine.
        settle_s: How long a file must be unchanged to count as complete.
        tags: Kept with the run.
        keep_annotated_days: Annotated copies of flights older than this are removed, None for never.
    """

    inboxes: tuple[str, ...]
    since_ns: int = 0
    limit: int | None = None
    executor: ExecutorName = "local"
    n_workers: int = 1
    timeout_s: float = 3600.0
    max_attempts: int = 3
    settle_s: float = 10.0
    tags: Mapping[str, str] = field(default_factory=dict)
    keep_annotated_days: float | None = None


def open_executor(job: Job, options: BatchOptions, stop: StopRequest) -> Executor[Any]:
    """Return the workers that the options ask for."""
    kind = RayExecutor if options.executor == "ray" else LocalExecutor
    return kind(
        job,
        n_workers=options.n_workers,
        timeout_s=options.timeout_s,
        max_attempts=options.max_attempts,
        should_stop=stop.is_made,
    )
