"""What the inspection of a store depends on, and the rows it gives.

Apart from `derived`, since SciPy takes long to import.
"""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from inspect_pipeline.index.reading import select
from inspect_pipeline.index.schema import views_digest
from inspect_pipeline.inspection.rules import load_rules
from inspect_pipeline.resources import MIGRATIONS, app_version

if TYPE_CHECKING:
    from inspect_pipeline.arrays import Floats
    from inspect_pipeline.inspection.rules import Rules
    from inspect_pipeline.store.store import Store


_RISES = """
SELECT lat_deg, lon_deg, rise_m FROM frames
WHERE flight_id = ? AND rise_m IS NOT NULL
ORDER BY channel_id, frame_idx
"""
_MAX_RISES = 1000


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


def load_rises(store: Store, flight_id: str) -> Floats:
    """Return (S, 3) latitude, longitude and rise of the ground in m below frames; raises StoreError."""
    rows = select(store, _RISES, [flight_id])
    rises = np.array([[row["lat_deg"], row["lon_deg"], row["rise_m"]] for row in rows]).reshape(-1, 3)
    return rises[:: max(1, len(rises) // _MAX_RISES)]


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
