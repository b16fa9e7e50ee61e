"""The records of a flight's result.json, from which the index is built, and the result of `process`."""

from __future__ import annotations

import json
import time
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, Literal

from inspect_pipeline.recording.types import CameraChannel

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

# Version of the files in a flight's folder. A new one has recordings processed again, and older programs
# refuse the store. It stays the same for changes of derived data and for migrations of the index alone.
RESULT_VERSION = 4
ANNOTATED, SIDECAR = "annotated.mcap", "annotations.mcap"  # in a flight's folder
_DEFAULTS: dict[str, Any] = {"warnings": (), "annotations": ANNOTATED, "sha256": {}}  # of older versions


def parse_json(content: bytes | str) -> Any:
    """Parse JSON; raises ValueError also for nesting that is too deep."""
    try:
        return json.loads(content)
    except RecursionError as error:
        raise ValueError("nested too deeply") from error


@dataclass(frozen=True, slots=True)
class ModelRecord:
    """The detector that found the segments; `score_threshold` is the lowest score kept."""

    model_id: str
    name: str
    preset: str
    weights_sha256: str
    score_threshold: float


@dataclass(frozen=True, slots=True)
class RunRecord:
    """One `process` or `batch`: run_id is a UUID, started_at is in UTC, config is plain JSON.

    command and tags (of `batch --tag`) are None in records of older versions.
    """

    run_id: str
    started_at: datetime
    host: str
    app_version: str
    config_sha256: str
    config: Mapping[str, Any]
    command: Literal["process", "batch"] | None = None
    tags: Mapping[str, str] | None = None

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON values, times as ISO 8601 in UTC."""
        return asdict(self) | {"started_at": _to_iso(self.started_at)}

    @classmethod
    def from_json(cls, value: Mapping[str, Any]) -> RunRecord:
        """Read what `to_json` wrote; raises KeyError, TypeError or ValueError for anything else."""
        return cls(**{**value, "started_at": datetime.fromisoformat(value["started_at"])})


@dataclass(frozen=True, slots=True)
class FlightTotals:
    """Row counts of a flight; start_ns and end_ns are the log times of its first and last frame."""

    n_frames: int
    n_bad_frames: int
    n_segments: int
    n_lines: int
    start_ns: int | None
    end_ns: int | None


@dataclass(frozen=True, slots=True)
class FlightRecord:
    """Everything about a flight except its rows.

    Attributes:
        flight_id: sha256 of the recording in hex.
        status: "recovered" from a damaged recording; "failed" when a camera has no frame that can be decoded.
        reason: What was damaged or failed, else None.
        warnings: What is unusual about the recording.
        annotations: The file in the flight's folder that holds them, None without.
        ingested_at: When the flight was processed, in UTC.
        files: Size in bytes of each file in the flight's folder, set by the store at commit.
        sha256: Checksum in hex of each of these files; empty in flights of older versions.
    """

    flight_id: str
    source_uri: str
    source_bytes: int
    status: Literal["ok", "recovered", "failed"]
    reason: str | None
    warnings: tuple[str, ...]
    annotations: str | None
    ingested_at: datetime
    run: RunRecord
    model: ModelRecord
    channels: tuple[CameraChannel, ...]
    totals: FlightTotals
    files: Mapping[str, int] = field(default_factory=dict)
    sha256: Mapping[str, str] = field(default_factory=dict)

    def without_annotations(self) -> FlightRecord:
        """Return the record after the file that holds the annotations was removed."""
        files = {name: size for name, size in self.files.items() if name != self.annotations}
        sha256 = {name: digest for name, digest in self.sha256.items() if name != self.annotations}
        return replace(self, files=files, sha256=sha256, annotations=None)

    def to_json(self) -> dict[str, Any]:
        """Return the content of result.json: plain JSON values, times as ISO 8601 in UTC."""
        fields = asdict(self)
        fields["ingested_at"] = _to_iso(self.ingested_at)
        fields["run"] = self.run.to_json()
        return {"result_version": RESULT_VERSION, **fields}

    @classmethod
    def from_json(cls, value: Mapping[str, Any]) -> FlightRecord:
        """Read what `to_json` of this version or an older one wrote.

        Raises KeyError, TypeError or ValueError for anything else.
        """
        value = _DEFAULTS | dict(value)
        fields = {name: value[name] for name in cls.__dataclass_fields__}
        fields["ingested_at"] = datetime.fromisoformat(value["ingested_at"])
        fields["run"] = RunRecord.from_json(value["run"])
        fields["warnings"] = tuple(value["warnings"])
        fields["model"] = ModelRecord(**value["model"])
        fields["channels"] = tuple(CameraChannel(**channel) for channel in value["channels"])
        fields["totals"] = FlightTotals(**value["totals"])
        return cls(**fields)


@dataclass(frozen=True, slots=True)
class ProcessResult:
    """What `process` did with one recording; the fields are those of `process --json`.

    reason: what was lost, or that it is an annotated copy; warnings: what is odd about it;
    n_frames_replaced: the frames of the result that this one replaces in the store, None without one.
    """

    flight_id: str
    source: str
    status: Literal["ok", "skipped", "recovered", "failed"]
    annotated: Path | None
    n_frames: int
    n_bad_frames: int
    n_segments: int
    seconds: float
    reason: str | None = None
    warnings: tuple[str, ...] = ()
    n_lines: int = 0
    n_frames_replaced: int | None = None

    @classmethod
    def of(cls, record: FlightRecord, source: Path, folder: Path, started: float) -> ProcessResult:
        """Return the result for a flight in `folder` of the store; `started` is of `time.monotonic`."""
        return cls(
            flight_id=record.flight_id,
            source=str(source),
            status=record.status,
            annotated=folder / record.annotations if record.annotations else None,
            n_frames=record.totals.n_frames,
            n_bad_frames=record.totals.n_bad_frames,
            n_segments=record.totals.n_segments,
            n_lines=record.totals.n_lines,
            seconds=round(time.monotonic() - started, 3),
            reason=record.reason,
            warnings=record.warnings,
        )


def _to_iso(time: datetime) -> str:
    return time.astimezone(UTC).isoformat()
