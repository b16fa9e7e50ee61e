"""How long the report of a long flight takes, and how large it is: 10,000 frames, 300 anomalies.

The flight passes 227 spans of a simulated line. Its rows are the truth of the simulator; its anomalies are
written into the index, one after the other along the spans; its frames all show one simulated picture, and
their small pictures are made before, as at publish.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING
from unittest.mock import patch

import duckdb
from measure import conclude

from inspect_pipeline import iter_frames, open_recording, simulate
from inspect_pipeline.index.publish import publish
from inspect_pipeline.index.reading import open_index
from inspect_pipeline.inspection.spans import import_spans
from inspect_pipeline.report import thumbnails
from inspect_pipeline.simulation.options import SimulationOptions
from inspect_pipeline.simulation.truth import simulate_truth
from inspect_pipeline.store.store import Store

sys.path.append(str(Path(__file__).parents[1] / "tests" / "helpers"))
import inspected

if TYPE_CHECKING:
    from collections.abc import Iterator

    from inspect_pipeline.arrays import ImageArray

N_ANOMALIES, SECONDS, FPS = 300, 2500, 4
BARS = {"report_s": (0.0, 5.0), "bytes_beyond_1_mb_per_anomaly": (0.0, 25_000.0)}
_ANOMALIES = """
INSERT INTO anomalies BY NAME
SELECT printf('%012x', i) AS anomaly_id, flight_id, channel_id, 'conductor_gap' AS kind,
       printf('3 of 4 conductors for 3.0 m from 27 m of span %s', span_id) AS reason,
       3.0 AS value, 2.0 AS threshold, 'm' AS unit, frame_idx AS first_frame_idx, frame_idx AS last_frame_idx,
       [frame_idx, frame_idx + 6, frame_idx + 12, frame_idx + 18] AS evidence_frames,
       log_time_ns AS start_ns, log_time_ns AS end_ns, span_id,
       (from_lat_deg + to_lat_deg) / 2 AS lat_deg, (from_lon_deg + to_lon_deg) / 2 AS lon_deg,
       ['high', 'medium', 'low'][1 + i % 3] AS priority
FROM (
    SELECT *, row_number() OVER (ORDER BY frame_idx) - 1 AS i, count(*) OVER () AS n
    FROM conductor_counts JOIN spans USING (span_id) JOIN frames USING (flight_id, channel_id, frame_idx)
)
WHERE i % (n // $n_anomalies) = 0
ORDER BY i
LIMIT $n_anomalies
"""


def make_store(folder: Path) -> tuple[Store, str]:
    """A store with the flight, its anomalies and their pictures."""
    truth = simulate_truth(SimulationOptions(SECONDS, FPS, seed=1))
    store = Store(folder / "store")
    flight_id = inspected.write_truth(store, "long", truth)
    import_spans(store, inspected.spans_of(truth))
    publish(store)
    with duckdb.connect(store.index_path) as connection:
        connection.execute("DELETE FROM anomalies")
        connection.execute(_ANOMALIES, {"n_anomalies": N_ANOMALIES})
    simulate(folder / "one.mcap", SimulationOptions(seconds=0.1, image_size=truth.frames[0].image_size))
    image = next(iter_frames(open_recording(folder / "one.mcap"))).image

    def read(_source: object, wanted: dict[tuple[str, int], int]) -> Iterator[tuple[str, int, ImageArray]]:
        yield from ((topic, frame_idx, image) for topic, frame_idx in wanted)

    start = time.perf_counter()
    with (
        patch.object(thumbnails, "open_images", lambda *_: None),
        patch.object(thumbnails, "iter_images", read),
        open_index(store) as index,
    ):
        thumbnails.make_pictures(index, store, flight_id)
    print(f"pictures, without reading the images: {time.perf_counter() - start:.1f} s")
    return store, flight_id


def _cpu_s() -> float:
    """Processor time of all children so far: other programs delay the report, but do not change this."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--keep", type=Path, metavar="DIR", help="keep the store and the page here")
    folder = parser.parse_args().keep
    with tempfile.TemporaryDirectory() as scratch:
        place = folder or Path(scratch)
        store, flight_id = make_store(place)
        page = place / "report.html"
        command = [sys.executable, "-c", "from cli import main; main()", "report", flight_id[:16]]
        before_s, start = _cpu_s(), time.perf_counter()
        subprocess.run([*command, "-o", str(page), "--store", str(store.root)], check=True)
        elapsed_s, size_bytes = time.perf_counter() - start, page.stat().st_size
        print(f"{size_bytes / 1e6:.2f} MB")
    figures = {
        "report_s": elapsed_s,
        "cpu_s": _cpu_s() - before_s,
        "bytes_beyond_1_mb_per_anomaly": (size_bytes - 1e6) / N_ANOMALIES,
    }
    return conclude("report", figures, BARS)


if __name__ == "__main__":
    sys.exit(main())
