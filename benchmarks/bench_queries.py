"""The documented queries on an index of 1,000 flights and 10 million segments, in process, warm.

    python benchmarks/bench_queries.py [--flights 1000]

The index is made of numbers, flight by flight the same, by DuckDB itself. Every statement of docs/sql.md and
every named query runs twice; the second time counts. The exit code is 1 when one about all flights takes more
than 2 s, or one about a single flight more than 0.2 s; the last line is one JSON object.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import tempfile
import time
from pathlib import Path

import duckdb

from inspect_pipeline.named_queries import named_queries
from inspect_pipeline.resources import read_schema
from inspect_pipeline.tables import create_tables

DOCUMENT = Path(__file__).parents[1] / "docs" / "sql.md"
MAX_ONE_S, MAX_ALL_S = 0.2, 2.0
SETUP = Path(__file__).with_name("index_of_numbers.sql")


def make_index(connection: duckdb.DuckDBPyConnection, n_flights: int) -> None:
    create_tables(connection)
    connection.execute(SETUP.read_text(encoding="utf-8").replace("$flights", str(n_flights)))
    connection.execute(read_schema("views.sql"))
    connection.execute("CHECKPOINT")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--flights", type=int, default=1000)
    n_flights = parser.parse_args().flights
    questions = re.findall(r"```sql\n(.*?)```", DOCUMENT.read_text(encoding="utf-8"), re.DOTALL)
    seconds: dict[str, dict[str, float]] = {"one flight": {}, "all flights": {}}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "index.duckdb"
        with duckdb.connect(path) as connection:
            make_index(connection, n_flights)
        with duckdb.connect(
            path, read_only=True, config={"threads": "2", "memory_limit": "512MB"}
        ) as connection:
            row = connection.execute("SELECT flight_id FROM flights LIMIT 1 OFFSET 7").fetchone() or ("",)
            one = {name: query for name, query in named_queries().items() if query.parameters == ("flight",)}
            for name, query in one.items():
                if name != "whats_new":
                    seconds["one flight"][name] = timed(connection, query.with_values({"flight": row[0]}))
            one_summary = f"SELECT * FROM flight_summary WHERE flight_id = '{row[0]}'"  # noqa: S608 - our own
            seconds["one flight"]["flight_summary"] = timed(connection, one_summary)
            for sql in [*questions, *(q.sql for q in named_queries().values() if not q.parameters)]:
                seconds["all flights"][" ".join(sql.split())[:70]] = timed(connection, sql)
    for group, limit in (("one flight", MAX_ONE_S), ("all flights", MAX_ALL_S)):
        for name, taken in sorted(seconds[group].items(), key=lambda item: -item[1]):
            print(f"{group:12} {taken:7.3f} s {'SLOW' if taken > limit else '    '} {name}")
    slowest = {group: round(max(taken.values()), 3) for group, taken in seconds.items()}
    is_slow = slowest["one flight"] > MAX_ONE_S or slowest["all flights"] > MAX_ALL_S
    print(json.dumps({"flights": n_flights, "segments": n_flights * 10_000, "slowest_s": slowest}))
    return int(is_slow)


def timed(connection: duckdb.DuckDBPyConnection, sql: str) -> float:
    """Seconds that the second of two runs takes."""
    connection.execute(sql).fetchall()
    started = time.perf_counter()
    connection.execute(sql).fetchall()
    return time.perf_counter() - started


if __name__ == "__main__":
    sys.exit(main())
