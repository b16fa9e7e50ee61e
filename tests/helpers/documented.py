"""The store of docs/sql.md: two flights along a simulated line, and one with a picture that is broken.

Run as a script, it updates the answers in the documentation.
"""

from __future__ import annotations

import io
import re
import tempfile
from pathlib import Path

import duckdb
import flights
import inspected

from inspect_pipeline.index import publish as index
from inspect_pipeline.index import query_child, query_output
from inspect_pipeline.index.reading import select
from inspect_pipeline.inspection.spans import import_spans
from inspect_pipeline.simulation.options import FaultKind, FlightKind, SimulationOptions
from inspect_pipeline.simulation.truth import simulate_truth
from inspect_pipeline.store.feedback import add_review, add_tag
from inspect_pipeline.store.store import Store

DOCUMENT = Path(__file__).parents[2] / "docs" / "sql.md"
QUESTION = re.compile(r"```sql\n(.*?)```\n\n```\n(.*?)```", re.DOTALL)


def make_store(folder: Path) -> Store:
    store = Store(folder)
    faults = (FaultKind.MISSING_CONDUCTOR, FaultKind.BLUR, FaultKind.DROPOUT)
    monday = simulate_truth(SimulationOptions(16, 4, seed=11, faults=faults))
    tuesday = simulate_truth(SimulationOptions(20, 4, seed=11, flight=FlightKind.LOSS, faults=faults[:1]))
    monday_id = inspected.write_truth(store, "monday", monday)
    inspected.write_truth(store, "tuesday", tuesday)
    flights.write_flight(store, "broken", 3)
    import_spans(store, inspected.spans_of(tuesday))
    add_tag(store, monday_id, "line", "L12")
    index.publish(store)
    odd = "SELECT * FROM anomalies WHERE kind = 'blurred_frames' ORDER BY start_ns LIMIT 1"
    add_review(store, select(store, odd)[0], "dismissed", "dust on the lens")
    index.publish(store)
    return store


def answer(store: Store, sql: str) -> str:
    """What `lsnet-pipe query` prints."""
    shown = io.StringIO()
    with duckdb.connect(store.index_path, read_only=True) as connection:
        source = f"query({query_child.quote(sql)})"
        query_output.write_table(
            query_child.select_texts(connection, source), shown, is_shortened=True, max_rows=1000
        )
    return shown.getvalue()


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as scratch:
        documented = make_store(Path(scratch))
        text = DOCUMENT.read_text(encoding="utf-8")
        DOCUMENT.write_text(
            QUESTION.sub(lambda m: f"```sql\n{m[1]}```\n\n```\n{answer(documented, m[1])}```", text),
            encoding="utf-8",
        )
