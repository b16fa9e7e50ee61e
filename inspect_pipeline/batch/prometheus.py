"""Metrics of the latest batch in the text format of Prometheus, for its node exporter (extra `metrics`)."""

from __future__ import annotations

from dataclasses import asdict
from importlib.util import find_spec
from typing import TYPE_CHECKING

from inspect_pipeline.atomic import appearing
from inspect_pipeline.errors import OutputError

if TYPE_CHECKING:
    from pathlib import Path

    from inspect_pipeline.store.runs import RunSummary

_SUCCESSES = (0, 3)
_STATUSES = ("processed", "recovered", "skipped", "failed", "quarantined", "in_quarantine", "waiting", "left")


def write_metrics(path: Path, runs: list[RunSummary], n_quarantined: int) -> None:
    """Write the metrics of the last of `runs` to a file, whole or not at all; raises OutputError.

    The time of the last success is that of the last run that ended with 0 or 3, so a failing job shows by
    its age.
    """
    check_metrics(path)
    from prometheus_client import CollectorRegistry, Gauge, generate_latest  # noqa: PLC0415 - an extra

    registry = CollectorRegistry()

    def gauge(name: str, meaning: str, value: float) -> None:
        Gauge(f"lsnet_pipe_{name}", meaning, registry=registry).set(value)

    latest, counts = runs[-1], asdict(runs[-1].counts)
    successes = [run.finished_at.timestamp() for run in runs if run.exit_code in _SUCCESSES]
    gauge("last_success_timestamp_seconds", "End of the last batch that succeeded", max(successes, default=0))
    gauge("last_run_timestamp_seconds", "End of the last batch", latest.finished_at.timestamp())
    gauge("last_run_exit_code", "Exit code of the last batch", latest.exit_code)
    gauge("run_duration_seconds", "Duration of the last batch", latest.duration_s)
    gauge("frames", "Frames of the recordings processed in the last batch", counts["n_frames"])
    gauge("bad_frames", "Frames among them that could not be decoded", counts["n_bad_frames"])
    gauge("segments", "Line segments found in them", counts["n_segments"])
    gauge("quarantine_size", "Recordings in quarantine", n_quarantined)
    recordings = Gauge(
        "lsnet_pipe_recordings", "Recordings of the last batch by status", ["status"], registry=registry
    )
    for status in _STATUSES:
        recordings.labels(status).set(counts[f"n_{status}"])
    try:
        with appearing(path) as part:
            part.write_bytes(generate_latest(registry))
    except OSError as error:
        problem = f"the metrics cannot be written ({error.strerror})"
        raise OutputError(path, problem, "name another file") from error


def check_metrics(path: Path) -> None:
    """Raise OutputError when metrics cannot be written for lack of a package."""
    if find_spec("prometheus_client") is None:
        raise OutputError(path, "metrics need prometheus-client", "pip install 'lsnet-pipe[metrics]'")
