"""What is known of one flight: the records of its `result.json`, the truth from which the index is built."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, Literal

from inspect_pipeline.recording.types import CameraChannel

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

# Of what a flight's folder holds. Another one means that recordings are processed again, and that older
# programs refuse the store; what is derived from flights, and migrations of the index alone, leave it.
RESULT_VERSION = 2
ANNOTATED, SIDECAR = "annotated.mcap", "annotations.mcap"  # in a flight's folder
_BEFORE_2: dict[str, Any] = {"warnings": (), "annotations": ANNOTATED}


@dataclass(frozen=True, slots=True)
class ModelRecord:
    """The detector that made the segments; `score_threshold` is the least score that was kept."""

    model_id: str
    name: str
    preset: str
    weights_sha256: str
    score_threshold: float


@dataclass(frozen=True, slots=True)
class RunRecord:
    """One `process` or `batch`: run_id is a UUID, started_at is in UTC, config is plain JSON.

    command and tags, the tags of the run, are missing in records of before they were kept.
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
        """Plain JSON values, times as ISO 8601 in UTC."""
        return asdict(self) | {"started_at": _to_iso(self.started_at)}

    @classmethod
    def from_json(cls, value: Mapping[str, Any]) -> RunRecord:
        """The record that `to_json` wrote; raises KeyError, TypeError or ValueError for anything else."""
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
    """All that is known of a flight but its rows.

    flight_id is the sha256 of the recording in hex, ingested_at is in UTC. `files` maps the name of each
    file of the flight's folder to its size in bytes; the store fills it in when the flight is committed.
    warnings: what is odd about the recording; annotations: the file that holds them, None without.
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

    def with_files(self, files: Mapping[str, int]) -> FlightRecord:
        """The same flight with the sizes of its files."""
        return replace(self, files=dict(files))

    def without_annotations(self) -> FlightRecord:
        """The same flight after the file that holds its annotations was removed."""
        files = {name: size for name, size in self.files.items() if name != self.annotations}
        return replace(self, files=files, annotations=None)

    def to_json(self) -> dict[str, Any]:
        """The content of result.json: plain JSON values, times as ISO 8601 in UTC."""
        fields = asdict(self)
        fields["ingested_at"] = _to_iso(self.ingested_at)
        fields["run"] = self.run.to_json()
        return {"result_version": RESULT_VERSION, **fields}

    @classmethod
    def from_json(cls, value: Mapping[str, Any]) -> FlightRecord:
        """The record that `to_json` wrote, of this version or an older one.

        Raises KeyError, TypeError or ValueError for anything else.
        """
        value = _BEFORE_2 | dict(value)
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


def _to_iso(time: datetime) -> str:
    return time.astimezone(UTC).isoformat()
