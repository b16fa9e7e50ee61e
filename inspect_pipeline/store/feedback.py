"""What people told the store, and what is never derived: reviews of anomalies and tags of flights.

reviews.jsonl and tags.jsonl are logs, a line for each word; the latest word on a thing counts.
"""

from __future__ import annotations

import json
import os
from dataclasses import MISSING, asdict, dataclass, fields
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, Literal

from inspect_pipeline.atomic import store_errors
from inspect_pipeline.errors import StoreError

if TYPE_CHECKING:
    from pathlib import Path

    from inspect_pipeline.store.store import Store

Verdict = Literal["confirmed", "dismissed", "open"]  # open: an earlier review is taken back


@dataclass(frozen=True, slots=True)
class Review:
    """What someone made of an anomaly, with what it was, by which it is found again in a new result."""

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
    """A word on a flight; a value of None takes the tag away."""

    flight_id: str
    key: str
    value: str | None
    tagged_at: str


def add_review(
    store: Store, anomaly: dict[str, Any], verdict: Verdict, note: str, reviewed_by: str = ""
) -> Review:
    """Add a review of an anomaly, given as a row of the table; raises StoreError."""
    own = ("anomaly_id", "flight_id", "channel_id", "kind", "span_id", "start_ns", "end_ns")
    known = {name: anomaly[name] for name in own}
    review = Review(verdict=verdict, note=note, reviewed_at=_now(), reviewed_by=reviewed_by, **known)
    _append(store.root / "reviews.jsonl", asdict(review))
    return review


def add_tag(store: Store, flight_id: str, key: str, value: str | None) -> None:
    """Note a tag of a flight, or with None that it has it no more; raises StoreError."""
    _append(store.root / "tags.jsonl", asdict(Tag(flight_id, key, value, _now())))


def load_reviews(store: Store) -> list[Review]:
    """Return the latest review of each anomaly, unless it was taken back; raises StoreError."""
    reviews = [Review(**line) for line in _read(store.root / "reviews.jsonl", Review)]
    latest = {review.anomaly_id: review for review in reviews}
    return [review for review in latest.values() if review.verdict != "open"]


def load_tags(store: Store) -> list[Tag]:
    """The tags that flights have; raises StoreError."""
    tags = [Tag(**line) for line in _read(store.root / "tags.jsonl", Tag)]
    latest = {(tag.flight_id, tag.key): tag for tag in tags}
    return [tag for tag in latest.values() if tag.value is not None]


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


def _append(path: Path, line: dict[str, Any]) -> None:
    """Add a whole line, also after one that a power cut tore; on the disk when this returns."""
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


def _read(path: Path, kind: type[Review | Tag]) -> list[dict[str, Any]]:
    """The lines of a log; torn ones are passed over. Raises StoreError."""
    if not path.exists():
        return []
    lines = []
    with store_errors(path):
        for text in path.read_bytes().splitlines():
            try:
                line = json.loads(text)
            except ValueError:
                continue
            if not _fits(line, kind):
                raise StoreError(path, f"a line of it is no {kind.__name__.lower()}", "mend or remove it")
            lines.append(line)
    return lines


def _fits(line: Any, kind: type[Review | Tag]) -> bool:
    """Whether a line has the fields of a record; one of an older version lacks those with defaults."""
    names = {field.name for field in fields(kind)}
    needed = {field.name for field in fields(kind) if field.default is MISSING}
    return isinstance(line, dict) and needed <= set(line) <= names
