"""Summaries of runs of `process` and `batch`: runs/<run_id>.json in the store, and the hook of `--on-finish`.

summary.json is the summary of the latest batch.
"""

from __future__ import annotations

import json
import shlex
import subprocess
import sys
from collections import Counter
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

from inspect_pipeline.atomic import store_errors, write_whole
from inspect_pipeline.errors import HookError
from inspect_pipeline.store.records import RunRecord, parse_json

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from inspect_pipeline.store.records import ProcessResult
    from inspect_pipeline.store.store import Store


_HOOK_TIMEOUT_S = 300
_NO_ENDING = dict.fromkeys(
    ("finished_at", "exit_code", "error", "n_processed", "n_skipped", "n_failed", "n_quarantined")
)


@dataclass(frozen=True, slots=True)
class Counts:
    """Numbers of recordings by outcome, and of frames and detections in the processed ones.

    n_found: in the inbox; n_processed: new flights, of which n_recovered from damaged files; n_skipped: done
    before; n_failed: refused by `process`, or flights with status "failed", new or known; n_quarantined:
    given up in this run; n_in_quarantine: given up earlier and unchanged; n_waiting: still being written;
    n_left: untouched, because of the limit, a stop or an error.
    """

    n_found: int = 0
    n_processed: int = 0
    n_recovered: int = 0
    n_skipped: int = 0
    n_failed: int = 0
    n_quarantined: int = 0
    n_in_quarantine: int = 0
    n_waiting: int = 0
    n_left: int = 0
    n_frames: int = 0
    n_bad_frames: int = 0
    n_segments: int = 0
    n_lines: int = 0

    def plus(self, **more: int) -> Counts:
        """Return the counts with some of them increased."""
        return replace(self, **{name: getattr(self, name) + n for name, n in more.items()})


@dataclass(frozen=True, slots=True)
class RunSummary:
    """A run that has ended. finished_at is in UTC; error is its error message, None without."""

    run: RunRecord
    finished_at: datetime
    exit_code: int
    error: str | None
    counts: Counts

    @property
    def duration_s(self) -> float:
        """Seconds from start to end."""
        return (self.finished_at - self.run.started_at).total_seconds()

    def to_json(self) -> dict[str, Any]:
        """Return the content of summary.json: plain JSON values, times as ISO 8601 in UTC."""
        ending = {"finished_at": self.finished_at.isoformat(), "duration_s": round(self.duration_s, 3)}
        result = {"exit_code": self.exit_code, "error": self.error}
        return {**self.run.to_json(), **ending, **result, "counts": asdict(self.counts)}

    @classmethod
    def from_json(cls, value: Mapping[str, Any]) -> RunSummary:
        """Read what `to_json` wrote; raises KeyError, TypeError or ValueError for anything else."""
        run = {name: value[name] for name in RunRecord.__dataclass_fields__ if name in value}
        return cls(
            run=RunRecord.from_json(run),
            finished_at=datetime.fromisoformat(value["finished_at"]),
            exit_code=value["exit_code"],
            error=value["error"],
            counts=Counts(**value["counts"]),
        )


def summarize_process(
    run: RunRecord, results: Sequence[ProcessResult], *, n_found: int, n_failed: int, exit_code: int
) -> RunSummary:
    """Return the summary of a `process` of `n_found` recordings that ends now."""
    by_status = Counter(result.status for result in results)
    done = [result for result in results if result.status != "skipped"]
    counts = Counts(
        n_found=n_found,
        n_processed=by_status["ok"] + by_status["recovered"],
        n_recovered=by_status["recovered"],
        n_skipped=by_status["skipped"],
        n_failed=n_failed + by_status["failed"],
        n_left=n_found - len(results) - n_failed,
        n_frames=sum(result.n_frames for result in done),
        n_bad_frames=sum(result.n_bad_frames for result in done),
        n_segments=sum(result.n_segments for result in done),
        n_lines=sum(result.n_lines for result in done),
    )
    return RunSummary(run, datetime.now(UTC), exit_code, None, counts)


def save_run(store: Store, summary: RunSummary) -> None:
    """Save the summary of a run and, for a batch, also as the latest one; raises StoreError."""
    folder = store.root / "runs"
    text = json.dumps(summary.to_json(), indent=1) + "\n"
    with store_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
        write_whole(folder / f"{summary.run.run_id}.json", text)
        if summary.run.command == "batch":
            write_whole(store.root / "summary.json", text)


def load_runs(store: Store) -> list[RunSummary]:
    """Return the summaries of all runs, oldest first, skipping unreadable files; raises StoreError."""
    summaries = []
    with store_errors(store.root):
        for path in (store.root / "runs").glob("*.json"):
            try:
                summaries.append(RunSummary.from_json(parse_json(path.read_bytes())))
            except (AttributeError, KeyError, TypeError, ValueError):
                continue
    return sorted(summaries, key=lambda summary: summary.run.started_at)


def run_rows(runs: Iterable[RunRecord], summaries: Iterable[RunSummary]) -> list[dict[str, Any]]:
    """Return the rows of the table runs, in plain JSON: runs that made flights, or have ended."""
    flown = {run.run_id: run for run in runs}
    rows = {run_id: {**run.to_json(), **_NO_ENDING} for run_id, run in flown.items()}
    for summary in summaries:
        whole = summary.to_json()
        ending = {name: whole.get(name, whole["counts"].get(name)) for name in _NO_ENDING}
        rows[summary.run.run_id] = {**summary.run.to_json(), **ending}
    return list(rows.values())


def notify(command: str, summary: RunSummary) -> None:
    """Run a command, split as a shell does, with the summary in JSON on its stdin; raises HookError."""
    try:
        words = shlex.split(command)
        if not words:
            raise ValueError("it is empty")  # noqa: TRY301 - reported like the others
        subprocess.run(
            words,
            input=json.dumps(summary.to_json()),
            text=True,
            stdout=sys.stderr,
            timeout=_HOOK_TIMEOUT_S,
            check=True,
        )
    except (OSError, ValueError, subprocess.SubprocessError) as error:
        raise HookError(command, str(error)) from error
