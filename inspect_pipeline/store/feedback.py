"""User feedback, which is never derived: reviews of anomalies, tags of flights, corrected lines of frames.

reviews.jsonl, tags.jsonl and corrections.jsonl are append-only logs, a line per decision; the latest counts.
"""

from __future__ import annotations

import json
import os
from dataclasses import MISSING, asdict, dataclass, fields
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, Literal, get_args

from inspect_pipeline.atomic import store_errors
from inspect_pipeline.errors import StoreError
from inspect_pipeline.store.records import parse_json

if TYPE_CHECKING:
    from pathlib import Path

    from inspect_pipeline.store.store import Store

_CORRECTIONS = "corrections.jsonl"

Verdict = Literal["confirmed", "dismissed", "open"]  # open takes a decision back


@dataclass(frozen=True, slots=True)
class Review:
    """A decision about an anomaly, with what identifies the anomaly in a new result of the flight.

    reviewed_at is ISO 8601 in UTC; reviewed_by is empty in reviews of older versions.
    """

    anomaly_id: str
    verdict: Verdict
    note: str
    reviewed_at: str
    flight_id: str
    channel_id: int
    kind: str
    span_id: str | None
    start_ns: int
    end_ns: int
    reviewed_by: str = ""


@dataclass(frozen=True, slots=True)
class Tag:
    """A tag of a flight; a value of None removes it."""

    flight_id: str
    key: str
    value: str | None
    tagged_at: str


@dataclass(frozen=True, slots=True)
class Correction:
    """All lines of a frame as a person says, each a list of [x, y]; units are px."""

    flight_id: str
    channel_id: int
    frame_idx: int
    log_time_ns: int
    width: int
    height: int
    lines: list[list[list[float]]]
    corrected_at: str
    corrected_by: str


def add_review(
    store: Store, anomaly: dict[str, Any], verdict: Verdict, note: str, reviewed_by: str = ""
) -> Review:
    """Record a review of an anomaly, given as a row of the table; raises StoreError."""
    own = ("anomaly_id", "flight_id", "channel_id", "kind", "span_id", "start_ns", "end_ns")
    known = {name: anomaly[name] for name in own}
    review = Review(verdict=verdict, note=note, reviewed_at=_now(), reviewed_by=reviewed_by, **known)
    _append(store.root / "reviews.jsonl", asdict(review))
    return review


def add_tag(store: Store, flight_id: str, key: str, value: str | None) -> None:
    """Record a tag of a flight, or with None its removal; raises StoreError."""
    _append(store.root / "tags.jsonl", asdict(Tag(flight_id, key, value, _now())))


def add_correction(
    store: Store, frame: dict[str, Any], lines: list[list[list[float]]], corrected_by: str
) -> Correction:
    """Record the lines of a frame, given by its fields of a Correction; raises StoreError."""
    correction = Correction(lines=lines, corrected_at=_now(), corrected_by=corrected_by, **frame)
    _append(store.root / _CORRECTIONS, asdict(correction))
    return correction


def load_corrections(store: Store) -> list[Correction]:
    """Return the latest correction of each frame; raises StoreError."""
    corrections = [Correction(**line) for line in _read(store.root / _CORRECTIONS, Correction)]
    return list({(one.flight_id, one.channel_id, one.frame_idx): one for one in corrections}.values())


def load_reviews(store: Store) -> list[Review]:
    """Return the latest review of each anomaly, except those taken back; raises StoreError."""
    reviews = [Review(**line) for line in _read(store.root / "reviews.jsonl", Review)]
    latest = {review.anomaly_id: review for review in reviews}
    return [review for review in latest.values() if review.verdict != "open"]


def load_tags(store: Store) -> list[Tag]:
    """Return the current tags of all flights; raises StoreError."""
    tags = [Tag(**line) for line in _read(store.root / "tags.jsonl", Tag)]
    latest = {(tag.flight_id, tag.key): tag for tag in tags}
    return [tag for tag in latest.values() if tag.value is not None]


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


def _append(path: Path, line: dict[str, Any]) -> None:
    """Append a line and flush it to the disk; a line that a power cut tore is ended first."""
    with store_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("ab+") as file:
            if file.tell():
                file.seek(-1, os.SEEK_END)
                torn = file.read(1) != b"\n"
            else:
                torn = False
            file.write((b"\n" if torn else b"") + json.dumps(line).encode() + b"\n")
            file.flush()
            os.fsync(file.fileno())


def _read(path: Path, kind: type[Review | Tag | Correction]) -> list[dict[str, Any]]:
    """Read the lines of a log, skipping torn ones; raises StoreError."""
    if not path.exists():
        return []
    lines = []
    with store_errors(path):
        for text in path.read_bytes().splitlines():
            try:
                line = parse_json(text)
            except ValueError:
                continue
            if not _is_record(line, kind):
                raise StoreError(path, f"a line is not a {kind.__name__.lower()}", "correct or remove it")
            lines.append(line)
    return lines


def _is_record(line: Any, kind: type[Review | Tag | Correction]) -> bool:
    """Whether a line has the fields of a dataclass; those with a default may be missing."""
    if not isinstance(line, dict):
        return False
    known = {field.name: field for field in fields(kind)}
    required = {name for name, field in known.items() if field.default is MISSING}
    return required <= set(line) <= set(known) and line.get("verdict", "open") in get_args(Verdict)
