"""What the inspection of a store depends on, and the rows it gives.

Apart from `derived`, since SciPy takes long to import.
"""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING, Any, NamedTuple

from inspect_pipeline.index.schema import views_digest
from inspect_pipeline.inspection.rules import load_rules
from inspect_pipeline.resources import MIGRATIONS, app_version

if TYPE_CHECKING:
    from inspect_pipeline.inspection.rules import Rules
    from inspect_pipeline.store.store import Store


class Inspected(NamedTuple):
    """Rows of the tables anomalies, coverage (over all cameras) and span_judgements."""

    anomalies: list[dict[str, Any]]
    coverage: list[dict[str, Any]]
    judgements: list[dict[str, Any]]


def input_digests(store: Store) -> dict[str, str]:
    """Return a hash of each input of the index other than flights, by its name.

    Raises RulesError.
    """
    program = f"{app_version()} {len(MIGRATIONS)}"
    digests = {"program": _sha256(program.encode()), "views.sql": views_digest()}
    digests["rules"] = load_store_rules(store).sha256
    for name in ("spans.geojson", "reviews.jsonl", "tags.jsonl"):
        path = store.root / name
        digests[name] = _sha256(path.read_bytes() if path.exists() else b"")
    return digests


def load_store_rules(store: Store) -> Rules:
    """Load the rules of a store: its rules.toml, else the shipped ones; raises RulesError."""
    path = store.root / "rules.toml"
    return load_rules(path if path.exists() else None)


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
