"""What a run was asked to do, and how that is written down: the options, their hash, the records of it."""

from __future__ import annotations

import hashlib
import json
import platform
import uuid
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, Literal

from inspect_pipeline.resources import app_version
from inspect_pipeline.store.records import RESULT_VERSION, ModelRecord, RunRecord

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from lsnet import Detector

WriteMode = Literal["copy", "sidecar", "none"]  # where annotations go
SchemaName = Literal["protobuf", "ros2msg"]  # of annotations
ExecutorName = Literal["local", "ray"]  # where a batch has its workers


@dataclass(frozen=True, slots=True)
class PlacingOptions:
    """What a recording does not say of where its frames were taken; None leaves to it what it says.

    ground_alt_m: altitude of the ground as its positions count it. view_deg: from left to right of an image,
    for cameras without calibration. wire_m: diameter of the conductors whose width is expected. terrain: a
    model of how the ground rises and falls, else it is flat.
    """

    ground_alt_m: float | None = None
    view_deg: float | None = None
    wire_m: float = 0.022
    terrain: Path | None = None


@dataclass(frozen=True, slots=True)
class ProcessOptions:
    """What to make of a recording.

    topics: the cameras, None for all; every: of each camera every N-th frame; start_ns <= log time < end_ns.
    strict: refuse a damaged recording instead of processing the part that can be read.
    force: process again what the store already has.
    write: annotations to a copy of the recording, to a file of their own, or nowhere; schema: in which form.
    placing: what is known of positions and lenses beside the recording.
    """

    topics: tuple[str, ...] | None = None
    every: int = 1
    start_ns: int | None = None
    end_ns: int | None = None
    strict: bool = False
    force: bool = False
    write: WriteMode = "copy"
    schema: SchemaName = "protobuf"
    placing: PlacingOptions = PlacingOptions()


def start_run(detector: Detector, options: ProcessOptions) -> RunRecord:
    """The record of a run that begins now. Its hash is the same whenever its results would be."""
    return start_described_run(detector.describe(), options, "process", {})


def start_described_run(
    description: Mapping[str, str | int | float],
    options: ProcessOptions,
    command: Literal["process", "batch"],
    tags: Mapping[str, str],
) -> RunRecord:
    """`start_run` with a detector that is in another process, by what it says about itself."""
    config: dict[str, Any] = {
        "detector": dict(description),
        "topics": sorted(options.topics) if options.topics is not None else None,
        "every": options.every,
        "start_ns": options.start_ns,
        "end_ns": options.end_ns,
        "placing": _describe_placing(options.placing),
        "write": options.write,
        "schema": options.schema,
        "result_version": RESULT_VERSION,
    }
    return RunRecord(
        run_id=str(uuid.uuid4()),
        started_at=datetime.now(UTC),
        host=platform.node(),
        app_version=app_version(),
        config_sha256=_sha256(config),
        config=config,
        command=command,
        tags=dict(tags),
    )


def _describe_placing(placing: PlacingOptions) -> dict[str, Any]:
    """A terrain model is what is in it, wherever it lies; raises TerrainError."""
    told = asdict(placing)
    path = told.pop("terrain")
    if path is None:
        return told
    from inspect_pipeline.geometry.terrain import digest  # noqa: PLC0415 - loads much, and few need it

    return told | {"terrain_sha256": digest(path)}


def model_record(detector: Detector) -> ModelRecord:
    """The record of the weights that a detector runs."""
    description = detector.describe()
    fields: dict[str, Any] = {
        "name": str(description["weights"]),
        "preset": str(description["preset"]),
        "weights_sha256": str(description["weights_sha256"]),
        "score_threshold": float(description["min_score"]),
    }
    return ModelRecord(model_id=f"{fields['name']}-{_sha256(fields)[:12]}", **fields)


def run_metadata(flight_id: str, run: RunRecord, model: ModelRecord) -> dict[str, str]:
    """The `lsnet_pipe.run` metadata of an annotated copy."""
    return {
        "flight_id": flight_id,
        "app_version": run.app_version,
        "run_id": run.run_id,
        "started_at": run.started_at.isoformat(),
        "weights": model.name,
        "weights_sha256": model.weights_sha256,
        "config_sha256": run.config_sha256,
        "config": _canonical(run.config),
    }


def _canonical(value: Mapping[str, Any]) -> str:
    return json.dumps(value, sort_keys=True, separators=(",", ":"))


def _sha256(value: Mapping[str, Any]) -> str:
    return hashlib.sha256(_canonical(value).encode()).hexdigest()
