"""The documented queries on 10 million segments of 1,000 flights: in process, warm, and by the CLI.

    python benchmarks/bench_queries.py [--flights 1000]

The index is made of numbers, flight by flight the same, by DuckDB itself. Every statement of docs/sql.md and
every named query runs twice; the second time counts. `lsnet-pipe query --named` runs three times each, the
quickest counts, and what it takes longer. The exit code is 1 when a query about all flights takes more than
2 s, one about a single flight more than 0.2 s, or the CLI adds more than 0.6 s; the last line is one JSON
object.
"""

from __future__ import annotations

import argparse
import json
import re
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import duckdb

from inspect_pipeline.index.named_queries import NamedQuery, named_queries
from inspect_pipeline.index.schema import create_tables
from inspect_pipeline.resources import read_schema

DOCUMENT = Path(__file__).parents[1] / "docs" / "sql.md"
SETUP = Path(__file__).with_name("index_of_numbers.sql")
COMMAND = Path(sys.executable).with_name("lsnet-pipe")
MAX_S = {"one flight": 0.2, "all flights": 2.0, "CLI adds": 0.6}
CLI_RUNS = 3


def measure_queries(n_flights: int) -> dict[str, Any]:
    """Return the slowest of each group in s, and those that exceed their bar; print all."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "index.duckdb"
        with duckdb.connect(path) as connection:
            make_index(connection, n_flights)
        seconds = measure(path)
    missed = []
    for group, taken in seconds.items():
        for name, took_s in sorted(taken.items(), key=lambda item: -item[1]):
            print(f"{group:12} {took_s:7.3f} s {'SLOW' if took_s > MAX_S[group] else '    '} {name}")
            if took_s > MAX_S[group]:
                missed.append(f"{group}, {name}: {took_s:.3f} s, not {MAX_S[group]}")
    slowest = {group: round(max(taken.values()), 3) for group, taken in seconds.items()}
    return {
        "flights": n_flights,
        "segments": n_flights * 10_000,
        "slowest_s": slowest,
        "cli_adds_median_s": round(statistics.median(seconds["CLI adds"].values()), 3),
        "missed": missed,
    }


def make_index(connection: duckdb.DuckDBPyConnection, n_flights: int) -> None:
    """Create an index of generated rows, with its views."""
    create_tables(connection)
    connection.execute(SETUP.read_text(encoding="utf-8").replace("$flights", str(n_flights)))
    connection.execute(read_schema("views.sql"))
    connection.execute("CHECKPOINT")


def measure(path: Path) -> dict[str, dict[str, float]]:
    """Return seconds by group and query."""
    with duckdb.connect(path, read_only=True, config={"threads": "2", "memory_limit": "512MB"}) as connection:
        row = connection.execute("SELECT flight_id FROM flights LIMIT 1 OFFSET 7").fetchone() or ("",)
        named = {
            query: time_query(connection, with_flight(query, row[0])) for query in named_queries().values()
        }
        one = {
            query.name: taken
            for query, taken in named.items()
            if query.name != "whats_new" and query.parameters
        }
        sql = f"SELECT * FROM flight_summary WHERE flight_id = '{row[0]}'"  # noqa: S608 - our own
        one["flight_summary"] = time_query(connection, sql)
        every = {query.name: taken for query, taken in named.items() if query.name not in one}
        for sql in re.findall(r"```sql\n(.*?)```", DOCUMENT.read_text(encoding="utf-8"), re.DOTALL):
            every[" ".join(sql.split())[:70]] = time_query(connection, sql)
    added = {query.name: time_command(path, query, row[0]) - taken for query, taken in named.items()}
    return {"one flight": one, "all flights": every, "CLI adds": added}


def with_flight(query: NamedQuery, flight_id: str) -> str:
    """Return the statement for one flight, or for all."""
    return query.with_values(dict.fromkeys(query.parameters, flight_id))


def time_query(connection: duckdb.DuckDBPyConnection, sql: str) -> float:
    """Return the seconds of the second of two runs."""
    connection.execute(sql).fetchall()
    started = time.perf_counter()
    connection.execute(sql).fetchall()
    return time.perf_counter() - started


def time_command(index_path: Path, query: NamedQuery, flight_id: str) -> float:
    """Return the seconds of the command, the least of a few runs."""
    values = [f"--param={name}={flight_id}" for name in query.parameters]
    command = [str(COMMAND), "query", "--named", query.name, *values, "--store", str(index_path.parent)]
    taken = []
    for _ in range(CLI_RUNS):
        started = time.perf_counter()
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        taken.append(time.perf_counter() - started)
    return min(taken)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--flights", type=int, default=1000)
    result = measure_queries(parser.parse_args().flights)
    print(json.dumps(result))
    return 1 if result["missed"] else 0


if __name__ == "__main__":
    sys.exit(main())
