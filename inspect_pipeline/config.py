"""Options of a run, their hash, and the records that a flight keeps of them."""

from __future__ import annotations

import hashlib
import json
import platform
import uuid
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, Literal

from inspect_pipeline.errors import DetectorError
from inspect_pipeline.resources import app_version
from inspect_pipeline.store.records import RESULT_VERSION, ModelRecord, RunRecord

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from lsnet import Detector

WriteMode = Literal["copy", "sidecar", "none"]  # where annotations go
SchemaName = Literal["auto", "protobuf", "ros2msg"]  # of annotations
ExecutorName = Literal["local", "ray"]  # where a batch has its workers


@dataclass(frozen=True, slots=True)
class PlacingOptions:
    """Georeferencing inputs that the recording lacks; None uses what the recording has.

    Attributes:
        ground_alt_m: altitude of the ground, in the vertical datum of the recorded positions.
        view_deg: horizontal field of view of cameras without calibration, or with only a nominal lens.
        wire_m: diameter of the conductors, for the expected width of a wire in pixels.
        terrain: elevation model (GeoTIFF and the like); by default the ground is flat.
    """

    ground_alt_m: float | None = None
    view_deg: float | None = None
    wire_m: float = 0.022
    terrain: Path | None = None


@dataclass(frozen=True, slots=True)
class ProcessOptions:
    """Options of `process`.

    Attributes:
        topics: camera topics; None for all cameras.
        every: process every N-th frame of each camera.
        start_ns: first log time.
        end_ns: log time of the end, not included.
        strict: refuse a damaged recording instead of processing the part that can be read.
        force: process again what the store already has.
        write: write annotations to a copy of the recording, to a sidecar file of their own, or not at all.
        schema: message format of the annotations; by default ROS 2 messages in ROS 2 bags, else protobuf.
        placing: georeferencing inputs that the recording lacks.
        allow_empty: let a result without decoded frames replace one with some.
        signals: numbers of other topics to index with each frame: names, and paths such as
            "/battery.percentage".
        track_support: let tracks decide on lines whose score is near the least that is reported.
    """

    topics: tuple[str, ...] | None = None
    every: int = 1
    start_ns: int | None = None
    end_ns: int | None = None
    strict: bool = False
    force: bool = False
    write: WriteMode = "copy"
    schema: SchemaName = "auto"
    placing: PlacingOptions = PlacingOptions()
    allow_empty: bool = False
    signals: Mapping[str, str] = field(default_factory=dict)
    track_support: bool = True


DEFAULT_OPTIONS = ProcessOptions()


def load_detector() -> Detector:
    """Load the detector with the shipped weights. Raises DetectorError."""
    from lsnet import Detector, LSNetError  # noqa: PLC0415 - seconds to import

    try:
        return Detector.load()
    except LSNetError as error:
        raise DetectorError(str(error)) from error


def start_run(detector: Detector, options: ProcessOptions) -> RunRecord:
    """Return the record of a run that starts now; equal hashes mean equal results."""
    return start_described_run(detector.describe(), options, "process", {})


def start_described_run(
    description: Mapping[str, str | int | float],
    options: ProcessOptions,
    command: Literal["process", "batch"],
    tags: Mapping[str, str],
) -> RunRecord:
    """Return the record of a run whose detector, in another process, describes itself so."""
    config: dict[str, Any] = {
        "detector": dict(description),
        "topics": sorted(options.topics) if options.topics is not None else None,
        "every": options.every,
        "start_ns": options.start_ns,
        "end_ns": options.end_ns,
        "placing": _describe_placing(options.placing),
        "write": options.write,
        "schema": options.schema,
        "track_support": options.track_support,
        "result_version": RESULT_VERSION,
        **({"signals": dict(options.signals)} if options.signals else {}),  # as older versions without
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
    """Describe a terrain model by its content, not its path. Raises TerrainError."""
    fields = asdict(placing)
    path = fields.pop("terrain")
    if path is None:
        return fields
    from inspect_pipeline.geometry.terrain import digest  # noqa: PLC0415 - slow to import, seldom needed

    return fields | {"terrain_sha256": digest(path)}


def model_record(detector: Detector) -> ModelRecord:
    """Return the record of the weights of a detector."""
    description = detector.describe()
    fields: dict[str, Any] = {
        "name": str(description["weights"]),
        "preset": str(description["preset"]),
        "weights_sha256": str(description["weights_sha256"]),
        "score_threshold": float(description["min_score"]),
    }
    return ModelRecord(model_id=f"{fields['name']}-{_sha256(fields)[:12]}", **fields)


def run_metadata(flight_id: str, run: RunRecord, model: ModelRecord) -> dict[str, str]:
    """Return the `lsnet_pipe.run` metadata of an annotated copy."""
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
