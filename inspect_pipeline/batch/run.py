"""The nightly job: every recording of the inbox fully indexed, or in quarantine with a reason, or untouched.

inbox ── discover ── recordings not done ── workers ──┬── flights ── publish, at the end and every ten minutes
                                                      └── quarantine notes

Its only state is the store: killed at any point, it continues when it is run again.
"""

from __future__ import annotations

import time
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Any, Protocol

from inspect_pipeline.batch.inbox import Candidate, discover
from inspect_pipeline.batch.options import BatchOptions, open_executor
from inspect_pipeline.batch.processed_files import ANNOTATED_COPY, StatCache
from inspect_pipeline.batch.quarantine import Quarantine, QuarantineNote
from inspect_pipeline.batch.stop_request import StopRequest
from inspect_pipeline.batch.worker import WorkerFailure
from inspect_pipeline.config import start_described_run
from inspect_pipeline.errors import InspectError, StoreError
from inspect_pipeline.index.publish import published_flights
from inspect_pipeline.publishing import publish
from inspect_pipeline.store.records import ANNOTATED
from inspect_pipeline.store.runs import Counts, RunSummary, save_run

if TYPE_CHECKING:
    from collections.abc import Iterable

    from inspect_pipeline.batch.executor import Executor, Outcome
    from inspect_pipeline.batch.worker import Job
    from inspect_pipeline.store.records import FlightRecord, ProcessResult
    from inspect_pipeline.store.store import Store

_PUBLISH_EVERY_S = 600.0


class BatchReport(Protocol):
    """Receives events as they happen."""

    def __call__(self, event: str, **fields: object) -> None: ...


def run_batch(
    store: Store, job: Job, options: BatchOptions, report: BatchReport, stop: StopRequest | None = None
) -> RunSummary:
    """Process new recordings of the inboxes; errors of the run are in its summary.

    One batch per store runs at a time.

    Raises StoreBusyError while another batch holds the store, StoreError when it cannot be locked.
    """
    stop = stop or StopRequest()
    with store.batch_lock():
        with open_executor(job, options, stop) as executor:
            summary = _Batch(store, job, options, executor=executor, report=report, stop=stop).run()
        with suppress(StoreError):  # only now are all its workers dead
            store.remove_leftovers()
    return summary


def plan_batch(store: Store, job: Job, options: BatchOptions, report: BatchReport) -> list[Candidate]:
    """Return the recordings that a batch would process now; nothing is written.

    Raises InboxError, DetectorError, StoreError.
    """
    stop = StopRequest()
    with open_executor(job, options, stop) as executor:
        return _Batch(store, job, options, executor=executor, report=report, stop=stop).plan()


class _Batch:
    """One run, from the inbox to its summary."""

    def __init__(
        self,
        store: Store,
        job: Job,
        options: BatchOptions,
        *,
        executor: Executor[Any],
        report: BatchReport,
        stop: StopRequest,
    ) -> None:
        self._store, self._job, self._options = store, job, options
        self._executor, self._report, self._stop = executor, report, stop
        # Replaced when a worker describes its detector.
        self._run = start_described_run({}, job.options, "batch", options.tags)
        self._quarantine, self._cache = Quarantine(store), StatCache(store)
        self._published: dict[str, str] = {}
        self._counts = Counts()
        self._last_publish = time.monotonic()

    def run(self) -> RunSummary:
        """Run the batch and save its summary."""
        error: InspectError | None = None
        try:
            self._work()
        except InspectError as failure:
            error = failure
        summary = self._summary(error)
        try:
            save_run(self._store, summary)
            self._publish()
        except InspectError as failure:
            summary = self._summary(error or failure)
            with suppress(StoreError):
                save_run(self._store, summary)
        self._report("batch finished", exit_code=summary.exit_code, error=summary.error)
        return summary

    def plan(self) -> list[Candidate]:
        """Return the recordings that are neither done nor in quarantine, oldest first, at most `limit`."""
        found = discover(self._options.inboxes, since_ns=self._options.since_ns, without=self._store.root)
        self._counts = Counts(n_found=len(found.candidates))
        for link in found.links_out:
            self._report("link out of the inbox left alone", path=str(link))
        for folder in found.unreadable:
            self._report("folder of the inbox cannot be read", path=str(folder))
        description = self._executor.describe()
        self._run = start_described_run(description, self._job.options, "batch", self._options.tags)
        self._published = published_flights(self._store)
        due = [candidate for candidate in found.candidates if self._is_due(candidate)]
        return due[: self._options.limit]

    def _work(self) -> None:
        self._cache.compact()
        due = self.plan()
        self._report("batch started", run_id=self._run.run_id, n_found=self._counts.n_found, n_due=len(due))
        written, young = self._part(due)
        self._process(written)
        if young:
            self._process(self._wait_for(young))
        if self._options.keep_annotated_days is not None:
            self._remove_annotated_copies(timedelta(days=self._options.keep_annotated_days))

    def _is_due(self, candidate: Candidate) -> bool:
        """Whether a recording is to be processed; if not, it is counted."""
        if self._quarantine.holds(candidate, self._run.config_sha256):
            self._counts = self._counts.plus(n_in_quarantine=1)
            return False
        flight_id = self._cache.flight_id(candidate)
        if flight_id is None:
            return True
        known = self._known(flight_id)
        if known is None and flight_id != ANNOTATED_COPY:
            return True
        is_failed = known is not None and known.status == "failed"
        self._counts = self._counts.plus(n_failed=int(is_failed), n_skipped=int(not is_failed))
        return False

    def _known(self, flight_id: str) -> FlightRecord | None:
        """Return an undamaged flight of the same config; those in the index are not read again for that."""
        if flight_id == ANNOTATED_COPY:
            return None
        stored = self._store.find_flight(flight_id)
        if stored is None or stored.record.run.config_sha256 != self._run.config_sha256:
            return None
        if self._published.get(flight_id) == stored.result_sha256:
            return stored.record
        return self._store.load_flight(flight_id)

    def _part(self, candidates: list[Candidate]) -> tuple[list[Candidate], list[Candidate]]:
        """Split into complete recordings and those that may still be written."""
        parts: tuple[list[Candidate], list[Candidate]] = ([], [])
        for candidate in candidates:
            parts[not candidate.is_written(self._options.settle_s)].append(candidate)
        return parts

    def _wait_for(self, young: list[Candidate]) -> list[Candidate]:
        """Wait until recordings have settled, and return those that are complete."""
        last_seen = max(candidate.seen_at for candidate in young)
        self._stop.wait(last_seen + self._options.settle_s - time.monotonic())
        written, unfinished = self._part(young)
        self._counts = self._counts.plus(n_waiting=len(unfinished))
        for candidate in unfinished:
            self._report("recording still being written", path=str(candidate.path))
        return written

    def _process(self, candidates: Iterable[Candidate]) -> None:
        for outcome in self._executor.run(candidates, self._run):
            if isinstance(outcome.result, WorkerFailure):
                self._give_up(outcome, outcome.result)
            else:
                self._count(outcome.candidate, outcome.result)
            if time.monotonic() - self._last_publish >= _PUBLISH_EVERY_S:
                self._publish()

    def _count(self, candidate: Candidate, result: ProcessResult) -> None:
        is_copy = result.annotated == candidate.path
        if result.flight_id:  # one without images is opened again by the next run
            self._cache.add(candidate, ANNOTATED_COPY if is_copy else result.flight_id)
        self._quarantine.remove(str(candidate.path))
        if result.status == "skipped":
            self._counts = self._counts.plus(n_skipped=1)
        else:
            self._counts = self._counts.plus(
                n_processed=int(result.status != "failed"),
                n_recovered=int(result.status == "recovered"),
                n_failed=int(result.status == "failed"),
                n_frames=result.n_frames,
                n_bad_frames=result.n_bad_frames,
                n_segments=result.n_segments,
                n_lines=result.n_lines,
            )
        self._report(
            "recording done",
            path=str(candidate.path),
            status=result.status,
            flight_id=result.flight_id,
            n_frames=result.n_frames,
            n_bad_frames=result.n_bad_frames,
            n_segments=result.n_segments,
            n_lines=result.n_lines,
            duration_s=result.seconds,
        )
        if not result.flight_id:
            self._report("recording without images skipped", path=str(candidate.path), reason=result.reason)
        if result.reason and result.status in ("recovered", "failed"):
            event = "recording damaged" if result.status == "recovered" else "recording failed"
            self._report(event, path=str(candidate.path), reason=result.reason)
        for warning in result.warnings:
            self._report("recording odd", path=str(candidate.path), warning=warning)

    def _give_up(self, outcome: Outcome, failure: WorkerFailure) -> None:
        """Put a recording into quarantine, unless the file has changed since."""
        candidate = outcome.candidate
        if Candidate.at(candidate.path) != candidate:
            self._report("recording changed while it was read", path=str(candidate.path))
            return
        note = QuarantineNote(
            path=str(candidate.path),
            size_bytes=candidate.size_bytes,
            mtime_ns=candidate.mtime_ns,
            reason=failure.reason,
            detail=failure.detail,
            attempts=outcome.attempts,
            app_version=self._run.app_version,
            config_sha256=self._run.config_sha256,
            at=datetime.now(UTC).isoformat(),
        )
        self._quarantine.add(note)
        self._store.append_manifest("quarantine", path=note.path, reason=note.reason, run_id=self._run.run_id)
        self._counts = self._counts.plus(n_quarantined=1)
        self._report("recording quarantined", **note.to_json(), duration_s=round(outcome.seconds, 3))

    def _remove_annotated_copies(self, age: timedelta) -> None:
        """Remove the annotated copies of older flights; their rows stay."""
        flights, _ = self._store.scan()
        oldest = datetime.now(UTC) - age
        for flight in flights:
            if flight.record.ingested_at < oldest and (flight.folder / ANNOTATED).exists():
                self._store.remove_annotated_copy(flight)
                self._report("annotated copy removed", flight_id=flight.record.flight_id)

    def _publish(self) -> None:
        change = publish(self._store)
        self._last_publish = time.monotonic()
        self._report("index published", n_flights=change.n_flights, n_written=change.n_written)
        for folder, problem in change.damaged:
            self._report("flight damaged", path=str(folder), problem=problem)

    def _summary(self, error: InspectError | None) -> RunSummary:
        counts = self._counts
        n_settled = counts.n_processed + counts.n_skipped + counts.n_waiting
        n_refused = counts.n_failed + counts.n_quarantined + counts.n_in_quarantine
        exit_code = self._stop.exit_code or (3 if n_refused else 0)
        return RunSummary(
            run=self._run,
            finished_at=datetime.now(UTC),
            exit_code=error.exit_code if error else exit_code,
            error=str(error) if error else None,
            counts=counts.plus(n_left=counts.n_found - n_settled - n_refused),
        )
